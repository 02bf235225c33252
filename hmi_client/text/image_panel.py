"""The right panel: one image of the selected pair, a cursor in image pixels and a loupe."""

import math
from dataclasses import dataclass
from textwrap import wrap

from rich.segment import Segment
from textual import events
from textual.binding import Binding
from textual.message import Message
from textual.strip import Strip

from hmi_client.decoding import decoded
from hmi_client.errors import OperatorError, PictureError
from hmi_client.model import Entry, Picture, PixelUV
from hmi_client.session import OperatorSession
from hmi_client.text.cells import MARKER_COLOURS, HalfBlocks, Image, Window, sample, style
from hmi_client.text.panel import Panel
from protocol.messages import ViewName

MIN_LOUPE = (11, 5)  # columns, rows; below that it shows too little to aim by
MAX_LOUPE = (33, 17)
CROSS_RGB, FAINT_RGB = 0xFF3030, 0x808080
RESTING = style("#8a97a6")


@dataclass(frozen=True)
class Arrangement:
    """Where image and loupe stand in a panel, in cells; the image begins at the top left."""

    columns: int
    rows: int
    loupe: tuple[int, int, int, int] | None
    """Column, row, columns, rows."""


def arrange(columns: int, rows: int, aspect: float) -> Arrangement:
    """Puts the loupe under or beside the image, where it costs the image less.

    Args:
        columns, rows: of the panel.
        aspect: width / height of the image.
    """
    beside = min(max(columns - 1 - round(2 * rows * aspect), MIN_LOUPE[0]), MAX_LOUPE[0])
    under = min(max(rows - round(columns / aspect / 2), MIN_LOUPE[1]), MAX_LOUPE[1])
    left, top = columns - 1 - beside, rows - under
    if min(left, 2 * rows * aspect) >= min(columns, 2 * top * aspect) and left >= MIN_LOUPE[0]:
        return Arrangement(left, rows, (left + 1, 0, beside, rows))
    if top >= MIN_LOUPE[1]:
        return Arrangement(columns, top, (0, top, columns, under))
    return Arrangement(columns, rows, None)


def fit(
    arrangement: Arrangement, size: tuple[float, float], zoom: float, centre: PixelUV
) -> Window:
    """What is shown of an image (width, height in px): around the centre, not beyond it."""
    columns, rows = arrangement.columns, arrangement.rows
    px = max(size[0] / columns, size[1] / (2 * rows)) / zoom
    extents = (columns * px, 2 * rows * px)
    corner = [
        (full - extent) / 2
        if extent >= full
        else min(max(middle + 0.5 - extent / 2, 0.0), full - extent)
        for full, extent, middle in zip(size, extents, centre, strict=True)
    ]
    return Window(corner[0], corner[1], px, columns, rows)


class ImagePanel(Panel):
    """The picture of robot i (side 0) or j (side 1) of the selected pair."""

    TOPICS = ("pictures", "selection", "correspondences")
    BINDINGS = [  # noqa: RUF012, as Textual declares it
        Binding("space,enter", "pick", "Pick"),
        Binding("plus,equals_sign", "zoom(1.5)", "Zoom"),
        Binding("minus", "zoom(0.6667)", "out", show=False),
        Binding("0", "fit", "Fit"),
        Binding("up", "move(0,-1)", show=False),
        Binding("down", "move(0,1)", show=False),
        Binding("left", "move(-1,0)", show=False),
        Binding("right", "move(1,0)", show=False),
        Binding("shift+up", "move(0,-10)", show=False),
        Binding("shift+down", "move(0,10)", show=False),
        Binding("shift+left", "move(-10,0)", show=False),
        Binding("shift+right", "move(10,0)", show=False),
    ]

    class Picked(Message):
        """A point was picked in this panel; `complete` if it was the second one."""

        def __init__(self, side: int, complete: bool) -> None:
            super().__init__()
            self.side, self.complete = side, complete

    def __init__(self, session: OperatorSession, side: int) -> None:
        super().__init__(id=f"image{side}", classes="image")
        self.session = session
        self.side = side
        self.cursor: PixelUV = (0.0, 0.0)
        self.zoom = 1.0
        self._robot: str | None = None
        self._picture: Picture | None = None
        self._image: Image | None = None
        self._scale = 1
        self._centre: PixelUV = (0.0, 0.0)
        self._window: Window | None = None
        self._loupe: Window | None = None
        self._arrangement: Arrangement | None = None

    # ---- what is shown ---------------------------------------------------------------------------

    @property
    def _view(self) -> ViewName | None:
        return self._picture.view if self._picture else None

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height in full-resolution pixels."""
        if self._image is None:
            return None
        return self._image.shape[1] * self._scale, self._image.shape[0] * self._scale

    def _load(self) -> None:
        """Decodes the picture if it is another one than before."""
        pair = self.session.pair
        robot = pair[self.side] if pair else None
        picture = self.session.picture(robot) if robot else None
        if robot != self._robot:
            self._robot, self._image, self._picture = robot, None, None
        if picture is None or picture.view == self._view:
            return
        first = self._image is None
        try:
            self._image = decoded(picture)
        except PictureError as error:
            self._image, self._picture = None, None
            self.session.drop(f"image of {robot}", error)
            self.session.on_unreadable(picture.view.robot, str(error), picture.view)
            return
        self._picture, self._scale = picture, picture.scale
        if first and self.image_size is not None:
            self.zoom = 1.0
            self.cursor = (self.image_size[0] // 2, self.image_size[1] // 2)
            self._centre = self.cursor

    def paint(self) -> list[Strip]:
        self._load()
        self._titles()
        columns, rows = self.extent
        if self._image is None or self.image_size is None:
            self._window = self._loupe = None
            return self._waiting(columns, rows)
        width, height = self.image_size
        place = self._arrangement = arrange(columns, rows, width / height)
        self._window = fit(place, self.image_size, self.zoom, self._centre)
        picture = HalfBlocks(sample(self._image, self._window, self._scale))
        self._draw_markers(picture, self._window)
        self._draw_cursor(picture, self._window)
        lines = picture.strips()
        if place.loupe is None:
            self._loupe = None
            return lines
        left, _, loupe_columns, loupe_rows = place.loupe
        loupe = self._paint_loupe(loupe_columns, loupe_rows)
        if left == 0:
            return lines + loupe
        gap = Strip.blank(1, RESTING)
        return [Strip.join([a, gap, b]) for a, b in zip(lines, loupe, strict=True)]

    def _titles(self) -> None:
        frozen = "  FROZEN" if self.session.frozen else ""
        keeping = self.session.keeping(self._robot) if self._robot else ""
        view = f"  view {self._view.seq}" if self._view else ""
        self.title(f"{self._robot or 'no robot'}{view}{frozen}{keeping and '  ' + keeping}")
        u, v = self.cursor
        place = f"{u:.0f}, {v:.0f} px" + (f"  x{self.zoom:.1f}" if self.zoom > 1 else "")
        notice = self.session.picture_notice(self._robot) if self._robot else ""
        self.subtitle(notice or place if self._image is not None else "")

    def _waiting(self, columns: int, rows: int) -> list[Strip]:
        """Why there is no image, over as many lines as it takes."""
        text = "select two robots"
        if self._robot:
            text = self.session.picture_notice(self._robot)
            text = text or f"waiting for the image of {self._robot}"
        said = wrap(text, columns)[:rows]
        lines = [Strip.blank(columns, RESTING)] * rows
        for row, line in enumerate(said, start=(rows - len(said)) // 2):
            lines[row] = Strip([Segment(line.center(columns), RESTING)], columns)
        return lines

    def _markers(self) -> list[tuple[int, PixelUV, Entry]]:
        """Number, pixel in this image, and list entry."""
        return [
            (number, entry.pick.pixel_j if self.side else entry.pick.pixel_i, entry)
            for number, entry in enumerate(self.session.entries(), start=1)
        ]

    def nearest(self) -> Entry | None:
        """The confirmed correspondence whose marker is nearest to the cursor."""
        named = [(pixel, entry) for _, pixel, entry in self._markers() if entry.id is not None]
        if not named:
            return None
        return min(named, key=lambda item: math.dist(item[0], self.cursor))[1]

    def _draw_markers(self, picture: HalfBlocks, window: Window) -> None:
        for number, (u, v), entry in self._markers():
            column, half_row = window.half_cell(u, v)
            colour = marker_colour(number)
            view = entry.pick.view_j if self.side else entry.pick.view_i
            if entry.status in ("rejected", "erasing"):
                picture.text(column, half_row // 2, "x", "#ff5050")
            elif view == self._view:
                picture.text(column, half_row // 2, str(number), "#000000", colour)
            else:  # clicked at another moment: where it was then
                picture.text(column, half_row // 2, str(number), colour)
        half = self.session.half
        if half is not None and half.side == self.side:
            column, half_row = window.half_cell(*half.pixel)
            picture.text(column, half_row // 2, "◆", "#000000", "#ffffff")

    def _draw_cursor(self, picture: HalfBlocks, window: Window) -> None:
        column, half_row = window.half_cell(*self.cursor)
        colour = CROSS_RGB if self.has_focus else FAINT_RGB
        reach = 5 if window.rows >= 14 else 4
        for step in (*range(1 - reach, -1), *range(2, reach)):
            picture.dot(column + step, half_row, colour)
            picture.dot(column, half_row + step, colour)

    def _paint_loupe(self, columns: int, rows: int) -> list[Strip]:
        """One full-resolution pixel per half cell, the cursor in the middle."""
        assert self._image is not None
        u, v = (round(x) for x in self.cursor)
        self._loupe = Window(u - columns // 2, v - rows, 1.0, columns, rows)
        loupe = HalfBlocks(sample(self._image, self._loupe, self._scale))
        for number, (mu, mv), _ in self._markers():
            column, half_row = self._loupe.half_cell(mu, mv)
            loupe.dot(column, half_row, int(marker_colour(number)[1:], 16))
            loupe.text(column + 1, (half_row - 1) // 2, str(number), marker_colour(number))
        half = self.session.half
        if half is not None and half.side == self.side:
            loupe.dot(*self._loupe.half_cell(*half.pixel), 0xFFFFFF)
        self._draw_cursor(loupe, self._loupe)
        return loupe.strips()

    # ---- cursor ----------------------------------------------------------------------------------

    def move_to(self, u: float, v: float) -> None:
        """Puts the cursor on a pixel, inside the image, and keeps it in sight."""
        if self.image_size is None or self._arrangement is None:
            return
        width, height = self.image_size
        self.cursor = u, v = min(max(u, 0.0), width - 1.0), min(max(v, 0.0), height - 1.0)
        window = fit(self._arrangement, self.image_size, self.zoom, self._centre)
        column, half_row = window.half_cell(u, v)
        aside = not window.columns * 0.1 <= column < window.columns * 0.9
        above = not window.rows * 0.2 <= half_row < window.rows * 1.8
        if aside or above:
            self._centre = (u, v)
        self.repaint()

    def action_move(self, du: int, dv: int) -> None:
        self.move_to(round(self.cursor[0]) + du, round(self.cursor[1]) + dv)

    def action_zoom(self, factor: float) -> None:
        self.zoom = min(max(self.zoom * factor, 1.0), 64.0)
        self._centre = self.cursor
        self.repaint()

    def action_fit(self) -> None:
        self.zoom = 1.0
        self.repaint()

    def action_pick(self) -> None:
        try:
            ticket = self.session.pick(self.side, self.cursor, self._picture)
        except OperatorError as error:
            self.notify(str(error), severity="warning", timeout=4)
            return
        self.post_message(self.Picked(self.side, ticket is not None))

    def on_click(self, event: events.Click) -> None:
        """A click in the image moves the cursor there; a click in the loupe picks that pixel."""
        offset = event.get_content_offset(self)
        if offset is None or self._window is None or self._arrangement is None:
            return
        loupe = self._arrangement.loupe
        if loupe and offset.x >= loupe[0] and offset.y >= loupe[1] and self._loupe:
            u, v = self._loupe.pixel(offset.x - loupe[0], 2 * (offset.y - loupe[1]))
            self.move_to(round(u), round(v))
            self.action_pick()
        elif offset.x < self._arrangement.columns and offset.y < self._arrangement.rows:
            u, v = self._window.pixel(offset.x, 2 * offset.y + 0.5)
            self.move_to(round(u), round(v))

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_zoom(1.5)

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.action_zoom(1 / 1.5)


def marker_colour(number: int) -> str:
    """The colour of the n-th correspondence, from 1."""
    return MARKER_COLOURS[(number - 1) % len(MARKER_COLOURS)]
