"""The lines at the bottom: what to do next, why, what happened last, what the server confirmed."""

from collections.abc import Mapping

from rich.segment import Segment
from textual.strip import Strip

from fleetpose.hmi_client.assist.prompts import confirmation, next_step, reason
from fleetpose.hmi_client.assist.suggestions import Suggestions
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import PanelMixin, line


class StatusPanel(PanelMixin):
    """Three lines; painted at every tick, since silence has no event."""

    def __init__(
        self, session: OperatorSession, proposals: Suggestions, keys: Mapping[str, str]
    ) -> None:
        super().__init__(id="status")
        self.session = session
        self.proposals = proposals
        self._keys = keys

    def paint(self) -> list[Strip]:
        session, width = self.session, self.extent.width
        silent = session.silent
        dropped = session.drops.total()
        confirmed = f"dropped {dropped}  " if dropped else ""
        confirmed += confirmation(session) + " "
        event = (session.events[-1] if session.events else "")[: max(width - len(confirmed) - 2, 0)]
        tone = style("waiting", bold=True) if session.unconfirmed else style("dim")
        step = style("on red", "red", True) if silent else style("on step", "step", True)
        last = Strip(
            [
                Segment(f" {event}".ljust(width - len(confirmed)), style("dim")),
                Segment(confirmed, tone),
            ],
        )
        lines = [
            line(f" {next_step(session, self.proposals, self._keys)}", width, step),
            line(f" {reason(session)}", width, style("on why", "why")),
            last.adjust_cell_length(width, style("dim")),
        ]
        return lines[: self.extent.height]
