"""The list of correspondences of the selected pair: number, pixels, status, residual."""

from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.strip import Strip

from fleetpose.hmi_client.desk.colours import marker_colour
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.words import STATUS_WORDS, quality, shortened
from fleetpose.hmi_client.model.matrix import length_text
from fleetpose.hmi_client.model.records import Entry
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import Do, Panel

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

    def __init__(self, desk: Desk, do: Do) -> None:
        super().__init__(id="list")
        self.desk, self.session, self._do = desk, desk.session, do
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
        colour = marker_colour(number)

        def paint(tone: str) -> Style:
            return style(tone, background)

        segments = [
            Segment(f"{number:>2} ", style("#000000", colour, True)),
            Segment(f" {STATUS_WORDS[entry.status]:<12} ", paint(STATUS_COLOURS[entry.status])),
            Segment(fitted(entry, columns - 17), paint("text")),
        ]
        if columns > 46:
            segments.append(Segment(pixels(entry), paint("dim")))
        return Strip(segments).adjust_cell_length(columns, paint("dim"))

    def action_arrow(self, _: int, step: int) -> None:
        """The images' cursors go along."""
        self.at = min(max(self.at + step, 0), max(len(self.session.entries()) - 1, 0))
        entry = self.current()
        if entry is not None:
            self.desk.point_at(entry)
        self.repaint()

    def action_do(self, command: str) -> None:
        """For the entry under the cursor."""
        if command == "show":
            self._do("show", number=self.at + 1)
        else:
            self._do(command)

    def on_click(self, event: events.Click) -> None:
        offset = event.get_content_offset(self)
        if offset is not None:
            rows, count = self.extent.height, len(self.session.entries())
            self.at = max(0, min(self.at - rows // 2, count - rows)) + offset.y
            self.action_arrow(0, 0)
            self.action_do("show")


def fitted(entry: Entry, room: int) -> str:
    """Residuals or reason, as much as there is room for: a number is never cut."""
    text = quality(entry)
    if len(text) <= room:
        return text
    if entry.note or entry.residual_m is None:
        return shortened(text.strip(), room)
    return length_text(entry.residual_m).rjust(min(room, 8))


def pixels(entry: Entry) -> str:
    """Both pixels."""
    (u_i, v_i), (u_j, v_j) = entry.pick.pixel_i, entry.pick.pixel_j
    return f"  ({u_i:.0f}, {v_i:.0f}) ({u_j:.0f}, {v_j:.0f})"
