"""The middle panel: the symmetric error matrix. Every cell can be selected, hidden or not."""

import re

from rich.segment import Segment
from rich.style import Style
from textual import events
from textual.geometry import Size
from textual.scroll_view import ScrollView
from textual.strip import Strip

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.model.matrix import (
    HIDDEN,
    SELF,
    THROUGH,
    UNTRIED,
    Cell,
    Matrix,
    Quantity,
    length_text,
    matrix_of,
    title_of,
)
from fleetpose.hmi_client.model.records import Pair
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing.cells import Rows
from fleetpose.hmi_client.tui.drawing.heat_map import Grid, heat_map
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import Do, PanelMixin, line
from fleetpose.protocol.keys import ordered_pair

TONES = {"verified": "text", "plausible": "plausible", "ambiguous": "ambiguous", None: "faint"}
CLICKED, WATCHED = "•", "◂"
MAX_NAME = 9


class MatrixPanel(  # pyright: ignore[reportIncompatibleMethodOverride] - Textual's own bases differ
    ScrollView, PanelMixin, can_focus=True
):
    """Errors of all pairs; the largest bold, those above the threshold a hyphen.

    ScrollView comes first among the bases: a widget inherits the style sheet of the first only.
    """

    TOPICS = ("fleet", "selection", "settings", "others")
    SLOW = ("fleet",)
    BINDINGS = bindings.MATRIX  # pyright: ignore[reportAssignmentType]

    def __init__(self, desk: Desk, do: Do) -> None:
        super().__init__(id="matrix")
        self.desk, self.session, self._do = desk, desk.session, do
        self.cursor = (0, 1)
        self._matrix = Matrix((), "cm", {})
        self._shows: tuple[str, int, float, Quantity] | None = None
        self._selected: Pair | None = None
        self._rows: Rows | None = None
        self._others: dict[Pair, tuple[str, ...]] = {}

    # ---- geometry --------------------------------------------------------------------------------

    @property
    def head(self) -> int:
        """Columns of the names on the left."""
        longest = max((len(name) for name in self._matrix.robots), default=2)
        return min(longest, MAX_NAME) + 1

    @property
    def pitch(self) -> int:
        """Columns per cell: the value, and one for the mark of correspondences."""
        return max(self._matrix.width, min(self.head - 1, 6), 3) + 2

    def cell_at(self, x: int, y: int) -> tuple[int, int] | None:
        """Row and column of the cell under a place of the content area."""
        if self.desk.overview:
            row, column = self._grid.robot_at(2 * (y - 1)), self._grid.robot_at(x)
            return None if row is None or column is None or y < 1 else (row, column)
        count = len(self._matrix.robots)
        column = (x - self.head + self.scroll_offset.x) // self.pitch
        row = y - 1 + self.scroll_offset.y
        inside = x >= self.head and y >= 1 and row < count and column < count
        return (row, column) if inside else None

    # ---- painting --------------------------------------------------------------------------------

    def paint(self) -> list[Strip]:
        session = self.session
        fleet, threshold_m = session.fleet, session.threshold_m
        if fleet is not None:
            shows = (fleet.server_epoch, fleet.n, threshold_m, self.desk.quantity)
            if self._shows != shows:
                self._shows = shows
                self._matrix = matrix_of(fleet, threshold_m, self.desk.quantity)
        if self.desk.overview:
            return self._paint_overview()
        self._others = session.others()
        count = len(self._matrix.robots)
        size = Size(self.head + count * self.pitch, count + 1)
        if size != self.virtual_size:
            self.virtual_size = size
            self.call_after_refresh(self.repaint)  # only then can it scroll that far
        else:
            self._follow_selection()
        title = title_of(self.desk.quantity, self._matrix.unit)
        short = self.extent.width < len(title) + 2  # where the border would cut it
        self.title(re.sub(r" \(.*?\)", "", title) if short else title)
        errors = self.desk.quantity in ("rms", "regression")
        self.subtitle(
            f"- above {length_text(threshold_m)}" if errors else "t shows another quantity"
        )
        rows = range(self.scroll_offset.y, self.scroll_offset.y + self.extent.height - 1)
        first = self.scroll_offset.x // self.pitch
        columns = range(first, min(count, first + self.extent.width // self.pitch + 2))
        lines = [self._line("", [self._column_name(c) for c in columns])]
        for row in rows:
            if row < count:
                cells = [self._cell(row, column) for column in columns]
                lines.append(self._line(self._matrix.robots[row], cells))
        blank = Strip.blank(self.extent.width, style("faint"))
        return lines + [blank] * (self.extent.height - len(lines))

    @property
    def _grid(self) -> Grid:
        columns, rows = self.extent
        return Grid.fitting(len(self._matrix.robots), columns, rows - 1)

    def _paint_overview(self) -> list[Strip]:
        """All pairs in colours, above them what is under the cursor."""
        matrix, (columns, rows) = self._matrix, self.extent
        self.virtual_size = self.extent
        self._follow_selection()
        self.title(f"{title_of(self.desk.quantity, matrix.unit)}: all pairs")
        self.subtitle("dark is little, bright is much, orange is hidden or rejected; o goes back")
        if not matrix.robots:
            return [Strip.blank(columns, style("faint"))] * rows
        picture = heat_map(matrix, self._grid, columns, rows - 1, self.cursor, self.session.pair)
        self._rows = picture.rows(self._rows)
        return [line(f" {self._about_cursor()}", columns, style("text")), *self._rows.strips]

    def _about_cursor(self) -> str:
        robots = self._matrix.robots
        row, column = (min(k, len(robots) - 1) for k in self.cursor)
        cell = self._matrix.at(robots[row], robots[column])
        if row == column:
            return robots[row]
        words = {
            HIDDEN: "above the threshold, or rejected",
            THROUGH: "known only through others",
            UNTRIED: "never tried",
        }
        verdict = f", {cell.verdict}" if cell.verdict else ""
        clicked = ", clicked" if cell.clicked else ""
        what = words.get(cell.text, cell.text)
        return f"{robots[row]} - {robots[column]}: {what}{verdict}{clicked}"

    def _line(self, name: str, cells: list[Segment]) -> Strip:
        selected = name != "" and name in (self.session.pair or ())
        paint = style("on red", "red", True) if selected else style("name")
        head = Strip([Segment(shorten(name, self.head - 1).ljust(self.head - 1), paint)])
        left, width = self.scroll_offset.x % self.pitch, self.extent.width - self.head
        body = Strip(cells).crop(left, left + width)
        gap = Strip([Segment(" ", style("faint"))])
        return Strip.join([head, gap, body]).adjust_cell_length(self.extent.width, style("faint"))

    def _column_name(self, column: int) -> Segment:
        name = self._matrix.robots[column]
        selected = name in (self.session.pair or ())
        text = shorten(name, self.pitch - 1).rjust(self.pitch - 1) + " "
        return Segment(text, style("red text", bold=True) if selected else style("name"))

    def _cell(self, row: int, column: int) -> Segment:
        a, b = self._matrix.robots[row], self._matrix.robots[column]
        cell = self._matrix.at(a, b)
        mark = CLICKED if cell.clicked else " "
        if a != b and ordered_pair(a, b) in self._others:
            mark = WATCHED
        selected = a != b and ordered_pair(a, b) == self.session.pair
        at_cursor = (row, column) == self.cursor and self.has_focus
        return Segment(
            cell.text.rjust(self.pitch - 1) + mark, cell_style(cell, selected, at_cursor)
        )

    # ---- moving ----------------------------------------------------------------------------------

    def watch_scroll_x(self, old_value: float, new_value: float) -> None:
        super().watch_scroll_x(old_value, new_value)
        self.repaint()

    def watch_scroll_y(self, old_value: float, new_value: float) -> None:
        super().watch_scroll_y(old_value, new_value)
        self.repaint()

    def _follow_selection(self) -> None:
        """Puts the cursor on a pair that was selected elsewhere."""
        pair, robots = self.session.pair, self._matrix.robots
        if pair == self._selected or pair is None or not set(pair) <= set(robots):
            return
        self._selected = pair
        if set(pair) != {robots[k] for k in self.cursor if k < len(robots)}:
            self.cursor = (robots.index(pair[0]), robots.index(pair[1]))
            self.call_after_refresh(self._keep_in_sight)

    def _keep_in_sight(self) -> None:
        row, column = self.cursor
        if self.desk.overview:
            return
        left, top = self.scroll_offset
        width, height = self.extent.width - self.head, self.extent.height - 1
        x = min(max(left, (column + 1) * self.pitch - width), column * self.pitch)
        y = min(max(top, row + 1 - height), row)
        if (x, y) != (left, top):
            self.scroll_to(x, y, animate=False)

    def action_arrow(self, columns: int, rows: int) -> None:
        last = max(len(self._matrix.robots) - 1, 0)
        row, column = self.cursor
        self.cursor = (min(max(row + rows, 0), last), min(max(column + columns, 0), last))
        self._keep_in_sight()
        self.repaint()

    def action_do(self, command: str) -> None:
        """Selects the pair under the cursor; all else is done at the desk."""
        robots, (row, column) = self._matrix.robots, self.cursor
        if command != "select":
            self._do(command)
            self.repaint()
        elif row != column and max(row, column) < len(robots):
            self._do("select", a=robots[row], b=robots[column])

    def on_click(self, event: events.Click) -> None:
        offset = event.get_content_offset(self)
        cell = self.cell_at(*offset) if offset is not None else None
        if cell is not None:
            self.cursor = cell
            self.repaint()
            self.action_do("select")


def cell_style(cell: Cell, selected: bool, at_cursor: bool) -> Style:
    """Selected cells are red, the cursor is blue, values have the colour of their verdict."""
    if selected:
        return style("on red", "red cursor" if at_cursor else "red", True)
    background = "cursor" if at_cursor else "back"
    if cell.bold:
        return style("bright", background, True)
    value = cell.level is not None and cell.verdict is None
    tone = "axes" if cell.text == SELF else "text" if value else TONES.get(cell.verdict, "faint")
    return style(tone, background)


def shorten(name: str, length: int) -> str:
    """A name cut to a length, its end kept: that is where robots differ."""
    return name if len(name) <= length else "…" + name[len(name) - length + 1 :]
