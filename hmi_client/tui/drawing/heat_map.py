"""All pairs at once, a half cell or more each: where the errors are in a fleet of any size."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.matrix import HIDDEN, SELF, THROUGH, Matrix
from fleetpose.hmi_client.model.records import Pair
from fleetpose.hmi_client.tui.drawing.cells import HalfBlocks, Image
from fleetpose.hmi_client.tui.drawing.palette import rgb
from fleetpose.protocol.keys import ordered_pair

LEVELS = 256
# Dark blue over green to yellow (viridis): in order also for those who tell few colours apart.
RAMP: Image = np.asarray(
    cv2.applyColorMap(np.arange(LEVELS, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS), np.uint8
)[:, 0]


@dataclass(frozen=True)
class Grid:
    """Which robot's row and column is under which half cell.

    Attributes:
        robots: how many there are.
        size: half cells of the square that shows them.
    """

    robots: int
    size: int

    @classmethod
    def fitting(cls, robots: int, columns: int, rows: int) -> "Grid":
        """The largest square in so many cells; whole half cells per robot where there is room."""
        room = min(columns, 2 * rows)
        whole = room // max(robots, 1) * robots
        return cls(robots, whole or room)

    def indices(self) -> npt.NDArray[np.int_]:
        """(size,) the robot of each half cell."""
        return np.arange(self.size) * self.robots // self.size

    def robot_at(self, half_cell: int) -> int | None:
        """The robot of one half cell; none outside."""
        return half_cell * self.robots // self.size if 0 <= half_cell < self.size else None


def heat_map(
    matrix: Matrix,
    grid: Grid,
    columns: int,
    rows: int,
    cursor: tuple[int, int],
    pair: Pair | None,
) -> HalfBlocks:
    """Draws a matrix into a square of half cells.

    Args:
        matrix: what is shown.
        grid: of as many robots.
        columns, rows: cells that there are.
        cursor: row and column, marked by a cross of lines.
        pair: the selected one.
    """
    count = grid.robots
    colours = np.empty((count, count, 3), np.uint8)
    for row, a in enumerate(matrix.robots):
        for column, b in enumerate(matrix.robots):
            colours[row, column] = _colour(matrix, a, b, a != b and ordered_pair(a, b) == pair)
    lit = np.zeros((count, count), np.bool_)
    lit[min(cursor[0], count - 1)] = lit[:, min(cursor[1], count - 1)] = True
    colours[lit] = np.clip(colours[lit].astype(int) + 40, 0, 255)
    canvas = np.empty((2 * rows, columns, 3), np.uint8)
    canvas[:] = _bgr(rgb("back"))
    at = grid.indices()
    canvas[: grid.size, : grid.size] = colours[at][:, at]
    return HalfBlocks(canvas)


def _colour(matrix: Matrix, a: str, b: str, selected: bool) -> tuple[int, int, int]:
    if selected:
        return _bgr(rgb("red cursor"))
    cell = matrix.at(a, b)
    if cell.level is not None:
        blue, green, red = RAMP[round(cell.level * (LEVELS - 1))].tolist()
        return blue, green, red
    roles = {HIDDEN: "outlier", THROUGH: "axes", SELF: "faint"}
    return _bgr(rgb(roles.get(cell.text, "back")))


def _bgr(rgb: int) -> tuple[int, int, int]:
    return rgb & 255, rgb >> 8 & 255, rgb >> 16
