"""What is drawn over an image: correspondences, half picks, expectations, hints, the cursor."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fleetpose.hmi_client.assist.pick_assist import Expected
from fleetpose.hmi_client.desk.colours import marker_colour
from fleetpose.hmi_client.desk.hints import Hints
from fleetpose.hmi_client.model.records import Entry, PixelUV
from fleetpose.hmi_client.tui.drawing import palette
from fleetpose.hmi_client.tui.drawing.cells import HalfBlocks, Window
from fleetpose.protocol.messages import ViewName

CROSS_RGB, FAINT_RGB, DEPTH_RGB = 0xFF3030, 0x808080, 0xF0E442


@dataclass(frozen=True)
class Overlay:
    """What there is to draw over the picture of one side.

    Attributes:
        view: of the picture.
        entries: the list of correspondences.
        side: of the image, 0 or 1.
        half: the pixel of a half pick in this image.
        expected: where the other half is expected, if that is here.
        fits: where the others put a point that they contradict, if that is in this image.
        hints: labels, while they are shown.
        depth: pixels that have depth, where only some have.
        cursor: where it is.
        focused: whether keys go here.
    """

    view: ViewName | None
    side: int
    cursor: PixelUV
    focused: bool
    entries: Sequence[Entry] = ()
    half: PixelUV | None = None
    expected: Expected | None = None
    fits: PixelUV | None = None
    hints: Hints | None = None
    depth: Sequence[PixelUV] = field(default=(), repr=False)

    def draw(self, picture: HalfBlocks, window: Window) -> None:
        """Draws over the overview."""
        for number, (u, v), entry in self.markers():
            column, half_row = window.half_cell(u, v)
            row, colour = half_row // 2, marker_colour(number)
            if entry.status in ("rejected", "erasing"):
                picture.text(column, row, "x", "red text")
            elif entry.status == "outlier":
                picture.text(column, row, f"{number}!", "#000000", colour)
            elif self.is_of_this_view(entry):
                picture.text(column, row, str(number), "#000000", colour)
            else:  # clicked at another moment: where it was then
                picture.text(column, row, str(number), colour)
        if self.expected is not None:
            for u, v in segment_pixels(self.expected):
                picture.dot(*window.half_cell(u, v), DEPTH_RGB)
            self._sign(picture, window, self.expected.pixel, "◇", "hint")
        elif self.fits is not None:
            self._sign(picture, window, self.fits, "◇", "hint")
        if self.half is not None:
            self._sign(picture, window, self.half, "◆", "#ffffff")
        draw_cursor(picture, window, self.cursor, self.focused)
        if self.hints is not None:
            typed = len(self.hints.typed)
            for label, (u, v) in self.hints.places.items():
                column, half_row = window.half_cell(u, v)
                picture.text(column, half_row // 2, label[typed:], "on hint", "hint")

    def draw_loupe(self, picture: HalfBlocks, window: Window) -> None:
        """Draws over the loupe, where a pixel is a half cell."""
        for u, v in self.depth:
            picture.dot(*window.half_cell(u, v), DEPTH_RGB)
        for number, (u, v), _ in self.markers():
            column, half_row = window.half_cell(u, v)
            picture.dot(column, half_row, int(marker_colour(number)[1:], 16))
            picture.text(column + 1, (half_row - 1) // 2, str(number), marker_colour(number))
        if self.half is not None:
            picture.dot(*window.half_cell(*self.half), 0xFFFFFF)
        draw_cursor(picture, window, self.cursor, self.focused)

    def markers(self) -> list[tuple[int, PixelUV, Entry]]:
        """Number, pixel in this image, and list entry."""
        return [
            (number, entry.pick.pixel_j if self.side else entry.pick.pixel_i, entry)
            for number, entry in enumerate(self.entries, start=1)
        ]

    def is_of_this_view(self, entry: Entry) -> bool:
        """Whether an entry was clicked in the very picture that is shown."""
        return (entry.pick.view_j if self.side else entry.pick.view_i) == self.view

    @staticmethod
    def _sign(picture: HalfBlocks, window: Window, pixel: PixelUV, sign: str, back: str) -> None:
        column, half_row = window.half_cell(*pixel)
        picture.text(column, half_row // 2, sign, "on hint", back)


def draw_cursor(picture: HalfBlocks, window: Window, cursor: PixelUV, focused: bool) -> None:
    """A cross with a gap in the middle, so that the pixel itself is seen."""
    column, half_row = window.half_cell(*cursor)
    reach = 5 if window.rows >= 14 else 4
    for step in (*range(1 - reach, -1), *range(2, reach)):
        for x, y in ((column + step, half_row), (column, half_row + step)):
            picture.dot(x, y, CROSS_RGB if focused else FAINT_RGB)
    if palette.theme() == "mono":
        picture.text(column, half_row // 2, "+", "text", "red" if focused else "")


def segment_pixels(expected: Expected) -> list[PixelUV]:
    """Pixels along the line on which something is expected."""
    if expected.segment is None:
        return []
    (u_0, v_0), (u_1, v_1) = expected.segment
    steps = np.linspace(0.0, 1.0, 40)
    return [(u_0 + s * (u_1 - u_0), v_0 + s * (v_1 - v_0)) for s in steps.tolist()]
