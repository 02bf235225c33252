"""Drawing with characters: images in half blocks, dots in braille, texts on a canvas.

Colours are cut to a few bits per channel: that makes runs of equal cells longer and lets the styles
be cached. Every style has its own background, because strips get none from their widget.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt
from rich.color import Color
from rich.segment import Segment
from rich.style import Style
from textual.strip import Strip

from fleetpose.hmi_client.tui.drawing.palette import few_colours, style, theme

Image = npt.NDArray[np.uint8]
OUTSIDE_BGR = (30, 24, 20)  # beyond the edge of an image
FINE_BITS, LIVE_BITS = 5, 4
_GREYS = " .:-=+*#%@"
_FEW_GREYS = np.array((0x000000, 0x555555, 0xAAAAAA, 0xFFFFFF), np.int32)  # as Rich knows the 16
_BAYER = (
    np.array(((0, 8, 2, 10), (12, 4, 14, 6), (3, 11, 1, 9), (15, 7, 13, 5)), np.float64) + 0.5
) / 16
_BRAILLE_BITS = np.array([[0x01, 0x08], [0x02, 0x10], [0x04, 0x20], [0x40, 0x80]])


@lru_cache(maxsize=1 << 12)
def pair_style(foreground: int, background: int) -> Style:
    """The style of two 24-bit colours 0xRRGGBB."""
    return Style.from_color(_color(foreground), _color(background))


def _color(rgb: int) -> Color:
    return Color.from_rgb(rgb >> 16, rgb >> 8 & 255, rgb & 255)


@dataclass(frozen=True)
class Window:
    """A rectangle of half cells over an image.

    Attributes:
        left, top: its corner in px from the image's corner (pixel (0, 0) covers 0 to 1).
        px_per_half: image pixels per half cell; a cell is one half cell wide and two high.
        columns, rows: size in cells.
    """

    left: float
    top: float
    px_per_half: float
    columns: int
    rows: int

    def pixel(self, column: float, half_row: float) -> tuple[float, float]:
        """The pixel under the centre of a half cell (integers are centres of pixels)."""
        u = self.left + (column + 0.5) * self.px_per_half - 0.5
        return u, self.top + (half_row + 0.5) * self.px_per_half - 0.5

    def half_cell(self, u: float, v: float) -> tuple[int, int]:
        """Column and half row that show a pixel; may lie outside."""
        column = (u + 0.5 - self.left) / self.px_per_half
        return int(np.floor(column)), int(np.floor((v + 0.5 - self.top) / self.px_per_half))


def sample(image: Image, window: Window, scale: float = 1.0) -> Image:
    """The image under a window, (2 rows, columns, 3) BGR, one value per half cell.

    Args:
        image: (H, W, 3) BGR; the window is in pixels that are `scale` times smaller than its own.
        window: what to show.
        scale: window pixels per image pixel.
    """
    step = window.px_per_half / scale
    left, top = window.left / scale, window.top / scale
    if step > 1.0:  # shrink by area first, else thin lines vanish
        height, width = image.shape[:2]
        size = (max(1, round(width / step)), max(1, round(height / step)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        left, top = left * size[0] / width, top * size[1] / height
        step = 1.0
    to_image = np.array([[step, 0, left + step / 2 - 0.5], [0, step, top + step / 2 - 0.5]])
    shown = cv2.warpAffine(
        image,
        to_image,
        (window.columns, 2 * window.rows),
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=OUTSIDE_BGR,
    )
    return np.asarray(shown, np.uint8)


def steadied(image: Image, shown: Image | None, noise: int) -> Image:
    """An image with the values that were shown before, where it differs from them by no more than a
    sensor's noise: then a camera that stands still repaints nothing.

    Args:
        image: (rows, columns, 3).
        shown: the same before; none or another size: the image as it is.
        noise: largest difference of a channel, levels.
    """
    if shown is None or shown.shape != image.shape:
        return image
    off = np.abs(image.astype(np.int16) - shown).max(axis=2)
    return np.where((off > noise)[..., None], image, shown)


def shades_of(image: Image, bits: int) -> npt.NDArray[np.int32]:
    """(rows, columns, 3) BGR as 0xRRGGBB of so many bits per channel; white stays white."""
    lost = 8 - bits
    bgr = (image >> lost << lost | image >> bits).astype(np.int32)
    return bgr[..., 2] << 16 | bgr[..., 1] << 8 | bgr[..., 0]


def greys_of(image: Image) -> npt.NDArray[np.int32]:
    """The same in the few greys that every terminal has, dithered: what is dark stays dark."""
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.float64)
    rows, columns = grey.shape
    raster = np.tile(_BAYER, (rows // 4 + 1, columns // 4 + 1))[:rows, :columns]
    steps = len(_FEW_GREYS) - 1
    return _FEW_GREYS[np.minimum((grey / 255.0 * steps + raster).astype(int), steps)]


@dataclass(frozen=True)
class Rows:
    """The strips of an image from top to bottom, and what each was made of."""

    keys: list[Hashable]
    by_key: dict[Hashable, Strip]

    @classmethod
    def of(
        cls, keys: list[Hashable], make: Callable[[int], Strip], before: "Rows | None"
    ) -> "Rows":
        """Makes only the strips that were not there before."""
        known = before.by_key if before is not None else {}
        by_key = {key: known.get(key) or make(row) for row, key in enumerate(keys)}
        return cls(keys, by_key)

    @property
    def strips(self) -> list[Strip]:
        return [self.by_key[key] for key in self.keys]

    def beside(self, right: "Rows", gap: Strip, before: "Rows | None" = None) -> "Rows":
        """Two images side by side."""
        pairs = list(zip(self.strips, right.strips, strict=True))
        keys: list[Hashable] = list(zip(self.keys, right.keys, strict=True))
        return Rows.of(keys, lambda row: Strip.join([pairs[row][0], gap, pairs[row][1]]), before)


class HalfBlocks:
    """An image of half cells on its way to strips; texts may be laid over it."""

    def __init__(self, image: Image, bits: int = FINE_BITS) -> None:
        """Takes (2 rows, columns, 3) BGR, and how many bits of each channel are to be seen."""
        packed = greys_of(image) if few_colours() else shades_of(image, bits)
        self.top, self.bottom = packed[0::2].copy(), packed[1::2].copy()
        self._over: dict[int, dict[int, tuple[str, Style]]] = {}

    @property
    def size(self) -> tuple[int, int]:
        """(columns, rows) in cells."""
        return self.top.shape[1], self.top.shape[0]

    def dot(self, column: int, half_row: int, rgb: int) -> None:
        """Colours one half cell if it is inside."""
        columns, rows = self.size
        if 0 <= column < columns and 0 <= half_row < 2 * rows:
            (self.bottom if half_row % 2 else self.top)[half_row // 2, column] = rgb

    def text(self, column: int, row: int, text: str, colour: str, background: str = "") -> None:
        """Lays a text over the cells; without a background the image shines through, darkened."""
        columns, rows = self.size
        for x, character in enumerate(text, start=column):
            if 0 <= row < rows and 0 <= x < columns:
                under = int(self.top[row, x]) >> 1 & 0x7F7F7F
                behind = background or f"#{under:06x}"
                self._over.setdefault(row, {})[x] = (character, style(colour, behind, True))

    def rows(self, before: Rows | None = None) -> Rows:
        """One strip per row of cells; without colours in a scale of characters.

        Args:
            before: the image that was shown before; rows that have not changed are its very
                strips.
        """
        columns, rows = self.size
        over = [self._over.get(row, {}) for row in range(rows)]
        keys: list[Hashable] = [
            (top.tobytes(), bottom.tobytes(), tuple(laid.items()))
            for top, bottom, laid in zip(self.top, self.bottom, over, strict=True)
        ]
        draw = self._row if theme() != "mono" else self._row_without_colours

        def make(row: int) -> Strip:
            return Strip(
                draw(self.top[row].tolist(), self.bottom[row].tolist(), over[row]), columns
            )

        return Rows.of(keys, make, before)

    @staticmethod
    def _row_without_colours(
        top: list[int], bottom: list[int], over: dict[int, tuple[str, Style]]
    ) -> list[Segment]:
        both = np.array((top, bottom))
        grey = (both >> 16 & 255) * 0.3 + (both >> 8 & 255) * 0.59 + (both & 255) * 0.11
        steps = (grey.mean(axis=0) / 256 * len(_GREYS)).astype(int).tolist()
        plain = [over.get(x, (_GREYS[step], style())) for x, step in enumerate(steps)]
        return _runs([t for t, _ in plain], [s for _, s in plain])

    @staticmethod
    def _row(
        top: list[int], bottom: list[int], over: dict[int, tuple[str, Style]]
    ) -> list[Segment]:
        segments: list[Segment] = []
        start = 0
        for x in range(1, len(top) + 1):
            same = (
                x < len(top)
                and top[x] == top[start]
                and bottom[x] == bottom[start]
                and not (over and (x in over or start in over))
            )
            if same:
                continue
            if over and start in over:
                segments.append(Segment(*over[start]))
            else:
                segments.append(Segment("▀" * (x - start), pair_style(top[start], bottom[start])))
            start = x
        return segments


class Canvas:
    """Characters with styles on a plain background, and braille dots (2 x 4 per cell) beneath."""

    def __init__(self, columns: int, rows: int) -> None:
        self.columns, self.rows = columns, rows
        self._dots = np.zeros((4 * rows, 2 * columns), np.bool_)
        self._blank = style("text")
        self._text = [[" "] * columns for _ in range(rows)]
        self._styles = [[self._blank] * columns for _ in range(rows)]

    def dots(self, xy: npt.NDArray[np.floating], paint: Style) -> None:
        """Sets braille dots, (N, 2) in dots from the top left; those outside are left out."""
        whole = np.floor(xy).astype(int)
        inside = ((whole >= 0) & (whole < (2 * self.columns, 4 * self.rows))).all(1)
        self._dots[whole[inside, 1], whole[inside, 0]] = True
        for x, y in {(x // 2, y // 4) for x, y in whole[inside].tolist()}:
            self._styles[y][x] = paint

    def text(self, column: int, row: int, text: str, paint: Style) -> None:
        """Writes a text; what is outside is left out. Blanks of it hide dots as well."""
        for x, character in enumerate(text.replace(" ", "\u00a0"), start=column):
            if 0 <= row < self.rows and 0 <= x < self.columns:
                self._text[row][x], self._styles[row][x] = character, paint

    def is_free(self, column: int, row: int, length: int) -> bool:
        """Whether no text is written there and all of it is inside."""
        if not 0 <= row < self.rows or column < 0 or column + length > self.columns:
            return False
        return all(character == " " for character in self._text[row][column : column + length])

    def strips(self) -> list[Strip]:
        """One strip per row."""
        braille = braille_of(self._dots)
        rows = []
        for text, under, styles in zip(self._text, braille, self._styles, strict=True):
            merged = [a if a != " " else b for a, b in zip(text, under, strict=True)]
            rows.append(Strip(_runs(merged, styles), self.columns))
        return rows


def braille_of(dots: npt.NDArray[np.bool_]) -> list[str]:
    """Rows of braille characters from dots (4 rows, 2 columns); a cell without dots is a blank."""
    height, width = dots.shape
    blocks = dots.reshape(height // 4, 4, width // 2, 2)
    codes = (blocks * _BRAILLE_BITS[None, :, None, :]).sum((1, 3))
    return ["".join(chr(0x2800 + c) if c else " " for c in row) for row in codes.tolist()]


def _runs(text: list[str], styles: list[Style]) -> list[Segment]:
    segments = []
    start = 0
    for x in range(1, len(text) + 1):
        if x == len(text) or styles[x] is not styles[start]:
            segments.append(Segment("".join(text[start:x]), styles[start]))
            start = x
    return segments
