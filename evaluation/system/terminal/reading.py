"""Reading the operator's screen: where the image panels are, where their cursors stand, what labels
they show.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from fleetpose.hmi_client.model.records import PixelUV
from fleetpose.hmi_client.tui.drawing.arrangement import arrange, fit
from fleetpose.hmi_client.tui.drawing.cells import Window

_TOP = re.compile(r"[╭┏][─━]+ (?P<title>[^─━╮┓]+) [─━]*[╮┓]")
_PIXEL = re.compile(r"(-?\d+), (-?\d+) px")
_LABEL = re.compile(r"(?<![a-z])[a-z]{1,2}(?![a-z])")


@dataclass(frozen=True)
class ShownImage:
    """An image panel on the screen.

    Attributes:
        robot: whose image.
        left, top: the first cell inside of its border.
        columns, rows: inside of its border.
        cursor: the pixel that its last line names.
        focused: whether keys go there.
        inside: its lines.
    """

    robot: str
    left: int
    top: int
    columns: int
    rows: int
    cursor: PixelUV
    focused: bool
    inside: tuple[str, ...]

    def window(self, size: tuple[int, int]) -> Window:
        """What of an image of that size (px) is shown, not zoomed."""
        place = arrange(self.columns, self.rows - 1, size[0] / size[1])
        return fit(place, size, 1.0, (size[0] / 2, size[1] / 2))

    def labels(self, size: tuple[int, int]) -> dict[str, PixelUV]:
        """The labels that are shown, and about where in the image."""
        window = self.window(size)
        found = {}
        for row, line in enumerate(self.inside[: window.rows]):
            for match in _LABEL.finditer(line[: window.columns]):
                found[match.group()] = window.pixel(match.start(), 2 * row + 0.5)
        return found


def images_on(lines: Sequence[str]) -> list[ShownImage]:
    """The image panels, from the top left; none without an image in it."""
    found = []
    for top, line in enumerate(lines):
        for match in _TOP.finditer(line):
            left, right = match.start(), match.end() - 1
            bottom = next(
                (k for k in range(top + 1, len(lines)) if lines[k][left : left + 1] in ("╰", "┗")),
                None,
            )
            if bottom is None:
                continue
            pixel = _PIXEL.match(lines[bottom - 1][left + 1 : right])
            if pixel is None:
                continue
            found.append(
                ShownImage(
                    robot=match["title"].split()[0],
                    left=left + 1,
                    top=top + 1,
                    columns=right - left - 1,
                    rows=bottom - top - 1,
                    cursor=(float(pixel[1]), float(pixel[2])),
                    focused=line[left] == "┏",
                    inside=tuple(row[left + 1 : right] for row in lines[top + 1 : bottom]),
                )
            )
    return found
