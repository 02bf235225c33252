"""The list of correspondences of the selected pair: number, pixels, status, residual."""

from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.message import Message
from textual.strip import Strip

from fleetpose.hmi_client.model.matrix import length_text
from fleetpose.hmi_client.model.records import Entry
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing.cells import MARKER_COLOURS
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import Panel

STATUS_COLOURS = {
    "accepted": "good",
    "unused": "dim",
    "outlier": "outlier",
    "pending": "waiting",
    "erasing": "waiting",
    "rejected": "red text",
}


class ListPanel(Panel):
    """One line per correspondence; the numbers and colours are those of the markers."""

    TOPICS = ("correspondences", "selection", "updates")
    BINDINGS = bindings.LIST  # pyright: ignore[reportAssignmentType]

    class Shown(Message):
        """An entry was chosen: the cursors should go to its pixels."""

        def __init__(self, entry: Entry) -> None:
            super().__init__()
            self.entry = entry

    def __init__(self, session: OperatorSession) -> None:
        super().__init__(id="list")
        self.session = session
        self.at = 0

    def current(self) -> Entry | None:
        """The entry under the cursor."""
        entries = self.session.entries()
        return entries[min(self.at, len(entries) - 1)] if entries else None

    def paint(self) -> list[Strip]:
        entries = self.session.entries()
        pair = self.session.pair
        self.title(f"{pair[0]} - {pair[1]}: {len(entries)} clicked" if pair else "clicked points")
        columns, rows = self.extent
        if not entries:
            text = " none yet" if pair else " no pair selected"
            return [
                Strip([Segment(text, style("faint"))]).adjust_cell_length(columns, style("faint"))
            ] + [Strip.blank(columns, style("faint"))] * (rows - 1)
        self.at = min(self.at, len(entries) - 1)
        top = max(0, min(self.at - rows // 2, len(entries) - rows))
        lines = [
            self._line(number, entries[number - 1], columns)
            for number in range(top + 1, min(len(entries), top + rows) + 1)
        ]
        return lines + [Strip.blank(columns, style("faint"))] * (rows - len(lines))

    def _line(self, number: int, entry: Entry, columns: int) -> Strip:
        background = "cursor" if self.has_focus and number - 1 == self.at else "back"
        colour = MARKER_COLOURS[(number - 1) % len(MARKER_COLOURS)]

        def paint(tone: str) -> Style:
            return style(tone, background)

        segments = [
            Segment(f"{number:>2} ", style("#000000", colour, True)),
            Segment(f" {entry.status:<8} ", paint(STATUS_COLOURS[entry.status])),
            Segment(quality(entry), paint("text")),
        ]
        if columns > 46:
            segments.append(Segment(pixels(entry), paint("dim")))
        return Strip(segments).adjust_cell_length(columns, paint("dim"))

    def action_move(self, _: int, step: int) -> None:
        self.at = min(max(self.at + step, 0), max(len(self.session.entries()) - 1, 0))
        self.repaint()

    def action_show(self) -> None:
        entry = self.current()
        if entry is not None:
            self.post_message(self.Shown(entry))

    def on_click(self, event: events.Click) -> None:
        offset = event.get_content_offset(self)
        if offset is not None:
            rows, count = self.extent.height, len(self.session.entries())
            self.at = max(0, min(self.at - rows // 2, count - rows)) + offset.y
            self.action_move(0, 0)
            self.action_show()


def quality(entry: Entry) -> str:
    """Residuals, or why it was rejected."""
    if entry.note:
        return entry.note
    words = [f"#{entry.id}".ljust(5)] if entry.id is not None else []
    if entry.residual_m is not None:
        words.append(length_text(entry.residual_m).rjust(8))
    if entry.residual_px is not None:
        words.append(f"{entry.residual_px:5.1f} px")
    if entry.by:
        words.append(f"by {entry.by}")
    return " ".join(words)


def pixels(entry: Entry) -> str:
    """Both pixels."""
    (u_i, v_i), (u_j, v_j) = entry.pick.pixel_i, entry.pick.pixel_j
    return f"  ({u_i:.0f}, {v_i:.0f}) ({u_j:.0f}, {v_j:.0f})"
