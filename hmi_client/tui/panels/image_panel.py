"""The right panel: one image of the selected pair, a cursor in image pixels and a loupe."""

from contextlib import suppress
from dataclasses import replace
from textwrap import wrap

from rich.segment import Segment
from textual import events
from textual.strip import Strip

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.hints import LETTERS, Hints
from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.jpeg import frame_of
from fleetpose.hmi_client.model.picture_decoder import decoded
from fleetpose.hmi_client.model.records import Picture, PixelUV
from fleetpose.hmi_client.tui import bindings
from fleetpose.hmi_client.tui.drawing.arrangement import Arrangement, arrange, fit
from fleetpose.hmi_client.tui.drawing.cells import (
    FINE_BITS,
    LIVE_BITS,
    HalfBlocks,
    Image,
    Rows,
    Window,
    sample,
    steadied,
)
from fleetpose.hmi_client.tui.drawing.overlay import Overlay
from fleetpose.hmi_client.tui.drawing.palette import style
from fleetpose.hmi_client.tui.panels.panel import Do, Panel
from fleetpose.protocol.messages import ViewName

# A half cell of the image is a mean over many pixels; the shades of live images are coarser yet.
NOISE_LEVELS = {"image": 16, "loupe": 24}


class ImagePanel(Panel):
    """The picture of robot i (side 0) or j (side 1) of the selected pair."""

    TOPICS = ("pictures", "selection", "correspondences", "depths")
    BINDINGS = bindings.IMAGES  # pyright: ignore[reportAssignmentType]

    def __init__(self, desk: Desk, side: int, do: Do) -> None:
        super().__init__(id=f"image{side}", classes="image")
        self.desk, self.session, self._do = desk, desk.session, do
        self.side = side
        self.zoom = 1.0
        self._robot: str | None = None
        self._picture: Picture | None = None
        self._image: Image | None = None
        self._scale = 1
        self._halved = False
        self._centre: PixelUV = (0.0, 0.0)
        self._window: Window | None = None
        self._loupe: Window | None = None
        self._arrangement: Arrangement | None = None
        self._shown_of: dict[str, tuple[Window, Image]] = {}
        self._rows_of: dict[str, Rows] = {}
        self._drawn_of: object = None
        self._drawn: list[Strip] = []
        self._followed: object = None

    # ---- what is shown ---------------------------------------------------------------------------

    @property
    def cursor(self) -> PixelUV:
        """Where the cursor is, in full-resolution pixels."""
        return self.desk.cursor(self.side)

    @property
    def hints(self) -> Hints | None:
        """Labels, while they are shown here."""
        return self.desk.hints if self.desk.side == self.side else None

    def follow(self) -> bool:
        """Keeps the cursor in sight, wherever the desk has put it; whether anything of the desk's
        is to be drawn anew.
        """
        wrong = self.desk.wrong()
        now = (self.cursor, self.hints, self.desk.expected_at(self.side), wrong)
        changed, self._followed = now != self._followed, now
        if changed:
            self._keep_in_sight()
        return changed

    @property
    def _view(self) -> ViewName | None:
        return self._picture.view if self._picture else None

    @property
    def image_size(self) -> tuple[int, int] | None:
        """Width and height in full-resolution pixels."""
        if self._image is None:
            return None
        return self._image.shape[1] * self._scale, self._image.shape[0] * self._scale

    def _may_halve(self, picture: Picture | None) -> bool:
        """Whether nobody looks that closely: a live picture beside the one that has the keys."""
        if picture is None or self.has_focus or self.session.frozen:
            return False
        with suppress(PictureError):  # `decoded` will say what is wrong
            frame = frame_of(picture.jpeg)
            return frame.width % 2 == 0 and frame.height % 2 == 0
        return False

    def _load(self) -> None:
        """Decodes the picture if it is another one than before."""
        pair = self.session.pair
        robot = pair[self.side] if pair else None
        picture = self.session.picture(robot) if robot else None
        if robot != self._robot:
            self._robot, self._image, self._picture = robot, None, None
            self._shown_of.clear()
        halved = self._may_halve(picture)
        if picture is None or (picture.view == self._view and (halved or not self._halved)):
            return
        first = self._image is None
        try:
            self._image = decoded(picture, halved)
        except PictureError as error:
            self._image, self._picture = None, None
            self.session.drop(f"image of {robot}", error)
            self.session.on_unreadable(picture.view.robot, str(error), picture.view)
            return
        self._picture, self._halved = picture, halved
        self._scale = picture.scale * (2 if halved else 1)
        if first and self.image_size is not None:
            self.zoom, self._centre = 1.0, self.cursor

    def paint(self) -> list[Strip]:
        self._load()
        self._titles()
        columns, rows = self.extent
        if self._image is None or self.image_size is None or min(columns, rows) < 2:
            self._window = self._loupe = None
            return self._waiting(columns, rows)
        width, height = self.image_size
        place = self._arrangement = arrange(columns, rows - 1, width / height)
        self._window = fit(place, self.image_size, self.zoom, self._centre)
        over, about = self._overlay(), self._about(columns)
        depths = self.session.depths(self._robot) if self._robot else None
        known = depths.view if depths is not None else None
        shown = (self._view, self._window, over, self._bits, known)
        if shown != self._drawn_of:
            self._drawn_of, self._drawn = shown, self._draw(self._image, place, over)
        return [*self._drawn, about]

    def _draw(self, image: Image, place: Arrangement, over: Overlay) -> list[Strip]:
        """The image and, beside or below it, the loupe."""
        assert self._window is not None
        picture = HalfBlocks(self._steady("image", image, self._window), self._bits)
        over.draw(picture, self._window)
        rows = self._rows("image", picture)
        if place.loupe is None:
            self._loupe = None
            return rows.strips
        left, _, loupe_columns, loupe_rows = place.loupe
        loupe = self._paint_loupe(over, loupe_columns, loupe_rows)
        if left == 0:
            return [*rows.strips, *loupe.strips]
        gap = Strip.blank(1, style("dim"))
        both = self._rows_of["both"] = rows.beside(loupe, gap, self._rows_of.get("both"))
        return both.strips

    def _rows(self, part: str, picture: HalfBlocks) -> Rows:
        """The strips of a part; what has not changed is not made anew."""
        rows = self._rows_of[part] = picture.rows(self._rows_of.get(part))
        return rows

    @property
    def _bits(self) -> int:
        """Nobody sees fine shades in what changes five times a second; a slow line feels them."""
        return FINE_BITS if self.session.frozen else LIVE_BITS

    def _steady(self, part: str, image: Image, window: Window) -> Image:
        """What a window shows of the image, without flickering; exactly while it is held still."""
        seen = sample(image, window, self._scale)
        before, shown = self._shown_of.get(part, (None, None))
        if before == window and not self.session.frozen:
            seen = steadied(seen, shown, NOISE_LEVELS[part])
        self._shown_of[part] = window, seen
        return seen

    def _titles(self) -> None:
        frozen = "  FROZEN" if self.session.frozen else ""
        keeping = self.session.keeping(self._robot) if self._robot else ""
        kept = {"": "", "pinned": "  held by the server", "not kept": "  not kept"}[keeping]
        self.title(f"{self._robot or 'no robot'}{frozen}{kept}")

    def _about(self, columns: int) -> Strip:
        """The last line: where the cursor is and in which view. A border's text would do, but
        setting one repaints the whole panel.
        """
        u, v = self.cursor
        place = f"{u:.0f}, {v:.0f} px" + (f"  x{self.zoom:.1f}" if self.zoom > 1 else "")
        notice = self.session.picture_notice(self._robot) if self._robot else ""
        view = f"view {self._view.seq}" if self._view else ""
        here = self.desk.expected_at(self.side)
        expected = "" if here is None else f"  ◇ {here.how}"
        text = (notice or place + self._depth_note() + expected)[:columns]
        shown = f"{text.ljust(columns - len(view) - 1)} {view}" if notice == "" else text
        return Strip([Segment(shown[:columns].ljust(columns), style("dim"))], columns)

    def _depth_note(self) -> str:
        """What is known of the depth under the cursor."""
        depths = self.session.depths(self._robot) if self._robot else None
        nearest = depths.nearest(self.cursor) if depths is not None else None
        if depths is None or (nearest is not None and nearest.distance_px <= depths.reach_px):
            return "" if nearest is None else f"  {nearest.z:.2f} m"
        far = "none near" if nearest is None else f"{nearest.distance_px:.0f} px away"
        return f"  no depth: {far}"

    def _waiting(self, columns: int, rows: int) -> list[Strip]:
        """Why there is no image, over as many lines as it takes."""
        text = "select two robots"
        if self._robot:
            text = self.session.picture_notice(self._robot)
            text = text or f"waiting for the image of {self._robot}"
        said = wrap(text, columns)[:rows]
        lines = [Strip.blank(columns, style("dim"))] * rows
        for row, line in enumerate(said, start=(rows - len(said)) // 2):
            lines[row] = Strip([Segment(line.center(columns), style("dim"))], columns)
        return lines

    def _overlay(self) -> Overlay:
        half, wrong = self.session.half, self.desk.wrong()
        here = wrong is not None and wrong.side == self.side and self.desk.shows(wrong.id)
        return Overlay(
            view=self._view,
            side=self.side,
            cursor=self.cursor,
            focused=self.has_focus,
            entries=self.session.entries(),
            half=half.pixel if half is not None and half.side == self.side else None,
            expected=self.desk.expected_at(self.side),
            fits=wrong.fits if here and wrong is not None else None,
            hints=self.hints,
        )

    def _paint_loupe(self, over: Overlay, columns: int, rows: int) -> Rows:
        """One full-resolution pixel per half cell, the cursor in the middle."""
        assert self._image is not None
        u, v = (round(x) for x in self.cursor)
        self._loupe = Window(u - columns // 2, v - rows, 1.0, columns, rows)
        loupe = HalfBlocks(self._steady("loupe", self._image, self._loupe), self._bits)
        depths = self.session.depths(self._robot) if self._robot else None
        if depths is not None and depths.scattered:
            over = replace(over, depth=depths.within(u, v, columns // 2 + 1, rows + 1))
        over.draw_loupe(loupe, self._loupe)
        return self._rows("loupe", loupe)

    # ---- cursor ----------------------------------------------------------------------------------

    def move_to(self, u: float, v: float) -> None:
        """Puts the cursor on a pixel, inside the image, and keeps it in sight."""
        self._do("cursor", side=self.side, pixel=(u, v))
        self.follow()
        self.repaint()

    def _keep_in_sight(self) -> None:
        if self.image_size is None or self._arrangement is None:
            return
        u, v = self.cursor
        window = fit(self._arrangement, self.image_size, self.zoom, self._centre)
        column, half_row = window.half_cell(u, v)
        aside = not window.columns * 0.1 <= column < window.columns * 0.9
        above = not window.rows * 0.2 <= half_row < window.rows * 1.8
        if aside or above:
            self._centre = (u, v)

    def action_arrow(self, du: int, dv: int) -> None:
        self.move_to(round(self.cursor[0]) + du, round(self.cursor[1]) + dv)

    def action_do(self, command: str) -> None:
        """Zooms are the image's own; all else is done at the desk, in this image."""
        match command:
            case "zoom-in":
                self._zoom(1.5)
            case "zoom-out":
                self._zoom(1 / 1.5)
            case "fit":
                self._zoom(0.0)
            case "pick" | "snap" | "move":
                self._do(command, side=self.side, seen=self._picture)
            case "go":
                self._go()
            case _:
                self._do(command)
        self.follow()
        self.repaint()

    def _zoom(self, factor: float) -> None:
        self.zoom, self._centre = min(max(self.zoom * factor, 1.0), 64.0), self.cursor

    def _go(self) -> None:
        """Labels appear over places that are in sight, so far apart that they can be read."""
        window = self._window
        if window is None:
            self._do("go", side=self.side)
            return
        left, top, px = window.left - 0.5, window.top - 0.5, window.px_per_half
        right, bottom = left + (window.columns - 1) * px, top + 2 * window.rows * px
        within, apart = (left, top, right, bottom), (4 * px, 4 * px)
        self._do("go", side=self.side, apart=apart, within=within, seen=self._picture)

    # ---- labels ----------------------------------------------------------------------------------

    def on_key(self, event: events.Key) -> None:
        """While labels are shown, letters choose one; any other key takes them away."""
        if self.hints is None:
            return
        event.stop()
        event.prevent_default()
        letter = event.character if event.character and event.character in LETTERS else ""
        self.desk.type_hint(letter)
        self.follow()
        self.repaint()

    def on_focus(self) -> None:
        self.desk.turn(self.side)
        super().on_focus()

    def on_blur(self) -> None:
        self.desk.hints = None
        super().on_blur()

    # ---- mouse -----------------------------------------------------------------------------------

    def on_click(self, event: events.Click) -> None:
        """A click in the image moves the cursor there; a click in the loupe picks that pixel."""
        offset = event.get_content_offset(self)
        if offset is None or self._window is None or self._arrangement is None:
            return
        loupe = self._arrangement.loupe
        x, y = offset.x - loupe[0] if loupe else 0, offset.y - loupe[1] if loupe else 0
        if loupe and 0 <= x < loupe[2] and 0 <= y < loupe[3] and self._loupe:
            u, v = self._loupe.pixel(x, 2 * y)
            self.move_to(round(u), round(v))
            self.action_do("pick")
        elif offset.x < self._arrangement.columns and offset.y < self._arrangement.rows:
            u, v = self._window.pixel(offset.x, 2 * offset.y + 0.5)
            self.move_to(round(u), round(v))

    def on_mouse_scroll_up(self, event: events.MouseScrollUp) -> None:
        event.stop()
        self.action_do("zoom-in")

    def on_mouse_scroll_down(self, event: events.MouseScrollDown) -> None:
        event.stop()
        self.action_do("zoom-out")
