"""The lines at the bottom: what to do next, why, what happened last, what the server confirmed."""

from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from hmi_client.advice import confirmation, next_step, reason
from hmi_client.session import OperatorSession
from hmi_client.text.cells import style
from hmi_client.text.panel import PanelMixin

STEP = style("#ffffff", "#1d3b5c", bold=True)
ALARM = style("#ffffff", "#b00020", bold=True)
WHY = style("#a9b8c8", "#16202c")
EVENT = style("#8a97a6", "#10141a")
OPEN = style("#f0e442", "#10141a", bold=True)


class StatusPanel(PanelMixin):
    """Three lines; painted at every tick, since silence has no event."""

    def __init__(self, session: OperatorSession) -> None:
        super().__init__(id="status")
        self.session = session

    def paint(self) -> list[Strip]:
        session, width = self.session, self.extent.width
        silent = session.silent
        dropped = session.drops.total()
        confirmed = f"dropped {dropped}  " if dropped else ""
        confirmed += confirmation(session) + " "
        event = (session.events[-1] if session.events else "")[: max(width - len(confirmed) - 2, 0)]
        last = Strip(
            [
                Segment(f" {event}".ljust(width - len(confirmed)), EVENT),
                Segment(confirmed, OPEN if session.unconfirmed else EVENT),
            ],
        )
        lines = [
            line(f" {next_step(session)}", width, ALARM if silent else STEP),
            line(f" {reason(session)}", width, WHY),
            last.adjust_cell_length(width, EVENT),
        ]
        return lines[: self.extent.height]


def line(text: str, width: int, paint: Style) -> Strip:
    """One line of one style, cut or filled to the width."""
    cut = text if len(text) <= width else text[: width - 1] + "…"
    return Strip([Segment(cut.ljust(width), paint)], width)
