"""The lines at the bottom: what to do next, why, what happened last, what the server confirmed."""

from collections.abc import Sequence

from rich.segment import Segment
from textual.strip import Strip

from fleetpose.hmi_client.desk.advice import Step, Tone, step
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.words import confirmation, plain, shortened
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import PanelMixin, line

_TROUBLE: tuple[Tone, ...] = ("warn", "gone")
_BETWEEN = "  ·  "


class StatusPanel(PanelMixin):
    """Painted at every tick, since silence has no event: a line of what to do, or two where that is
    too long for one, a line of facts, and one of what happened last.
    """

    def __init__(self, desk: Desk) -> None:
        super().__init__(id="status")
        self.desk, self.session = desk, desk.session

    def paint(self) -> list[Strip]:
        now, width = step(self.desk), self.extent.width
        trouble = now.tone in _TROUBLE
        paint = style("on warn", "warn", True) if trouble else style("on step", "step", True)
        todo = do_lines(now, width - 1)
        if self.extent.height < len(todo) + 2:
            todo = ["   ".join(todo)]
        lines = [line(f" {text}", width, paint) for text in todo]
        lines.append(line(f" {fitting(now.facts, width - 1)}", width, style("on why", "why")))
        lines.append(self._last(width))
        blank = Strip.blank(width, style("on why", "why"))
        lines[-1:-1] = [blank] * (self.extent.height - len(lines))
        return lines[: self.extent.height]

    def _last(self, width: int) -> Strip:
        session, dropped = self.session, self.session.drops.total()
        confirmed = f"dropped {dropped}  " if dropped else ""
        confirmed += confirmation(session) + " "
        event = plain(session.events[-1]) if session.events else ""
        event = shortened(event, width - len(confirmed) - 2)
        tone = style("waiting", bold=True) if session.unconfirmed else style("dim")
        last = Strip(
            [
                Segment(f" {event}".ljust(width - len(confirmed)), style("dim")),
                Segment(confirmed, tone),
            ],
        )
        return last.adjust_cell_length(width, style("dim"))


def do_lines(now: Step, width: int) -> list[str]:
    """What to do and by which keys: in one line, or in two where it is too long."""
    keys = ", ".join(f"{action.key} {action.label}" for action in now.actions if action.key)
    whole = f"{now.title}   {keys}".rstrip()
    return [whole] if len(whole) <= width or not keys else [now.title, keys]


def fitting(facts: Sequence[str], width: int) -> str:
    """As many whole facts as there is room for, the first at any rate."""
    text = ""
    for fact in facts:
        longer = f"{text}{_BETWEEN}{fact}" if text else fact
        if text and len(longer) > width:
            break
        text = longer
    return shortened(text, width)
