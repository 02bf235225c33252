"""Do a view's depths belong to its image? Depths of another moment lie beside what the image shows.

Two views of one robot show what depths to expect at the pixels of the later one. Where the robot's
depths are measured at another moment than its images, they fit best where they are looked up some
pixels aside, by as much as the image moved between the two moments.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]

LEAST_POINTS = 40
_CELL_PX_PER_WIDTH = 1 / 160  # cells of the map of depths: a view's points fill most of them
_REACH_CELLS = (14, 6)  # sideways and upright: robots turn more than they nod
_DEPTH_FLOOR = 0.015  # sigma of log depth: a cell is not a point
_MOST = 9.0  # squared sigmas beyond which a point is taken to see something else
_LEAST_FILLED = 0.6  # of the points' cells
_LEAST_GAIN = 10.0  # -2 log likelihood that most shifts cost more: else a plain wall
_EXCESS = 4.0  # neighbouring points share their errors: so many tell what one would


@dataclass(frozen=True)
class DepthShift:
    """Where a view's depths fit best.

    Attributes:
        shift_px: (2,) from a pixel of the image to where its depth is found.
        sigma_px: (2,) of it.
    """

    shift_px: Floats
    sigma_px: Floats


def depth_shift(
    size: tuple[int, int],
    cloud_uv: Floats,
    cloud_q: Floats,
    uv: Floats,
    expected_q: Floats,
    sigma: Floats,
) -> DepthShift | None:
    """Looks for the shift at which a view's depths are those that are expected.

    Args:
        size: width and height of the image, px.
        cloud_uv, cloud_q: (P, 2) px and (P,) 1/m, the view's depths.
        uv: (M, 2) px, where it should have
        expected_q: (M,) 1/m, these inverse depths, by another view;
        sigma: (M,) of their logarithms.

    Returns:
        None where the view does not determine it.
    """
    if len(uv) < LEAST_POINTS:
        return None
    cell = size[0] * _CELL_PX_PER_WIDTH
    depths = _log_map(size, cloud_uv, cloud_q, cell)
    reach_x, reach_y = _REACH_CELLS
    steps = np.mgrid[-reach_y : reach_y + 1, -reach_x : reach_x + 1]
    cost = _costs(depths, uv / cell, np.log(expected_q), sigma, steps.reshape(2, -1))
    cost = cost.reshape(steps.shape[1:]) / _EXCESS
    if not np.isfinite(cost[reach_y, reach_x]):
        return None
    row, column = np.unravel_index(np.nanargmin(cost), cost.shape)
    if np.nanmedian(cost) - cost[row, column] < _LEAST_GAIN:
        return None
    if not (0 < row < 2 * reach_y and 0 < column < 2 * reach_x):
        return None  # the best lies beyond
    around = cost[row - 1 : row + 2, column - 1 : column + 2]
    if not np.isfinite(around).all():
        return None
    offset = np.empty(2)
    sigma_cells = np.empty(2)
    for axis, (before, here, after) in enumerate((around[1], around[:, 1])):
        bend = max(before - 2 * here + after, 1e-3)
        offset[axis] = np.clip(0.5 * (before - after) / bend, -0.5, 0.5)
        sigma_cells[axis] = np.hypot(bend**-0.5, 0.3)
    found = np.array((column - reach_x, row - reach_y)) + offset
    return DepthShift(found * cell, sigma_cells * cell)


def _log_map(size: tuple[int, int], uv: Floats, q: Floats, cell: float) -> Floats:
    """(H, W) mean log inverse depth by cell, nan where there is none."""
    width, height = (int(np.ceil(length / cell)) for length in size)
    column = np.clip((uv[:, 0] / cell).astype(int), 0, width - 1)
    row = np.clip((uv[:, 1] / cell).astype(int), 0, height - 1)
    index = row * width + column
    count = np.bincount(index, minlength=width * height)
    total = np.bincount(index, np.log(q), minlength=width * height)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (total / count).reshape(height, width)


def _costs(
    depths: Floats, at: Floats, expected: Floats, sigma: Floats, steps: npt.NDArray[np.int64]
) -> Floats:
    """(S,) robust costs, -2 log likelihood, of looking depths up so many rows and columns aside;
    what all differ by alike is no matter. nan where too few cells have a depth.
    """
    column = at[:, 0].astype(int) + steps[1][:, None]
    row = at[:, 1].astype(int) + steps[0][:, None]
    height, width = depths.shape
    inside = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    found = depths[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    off = np.where(inside, found, np.nan) - expected
    filled = np.isfinite(off)
    enough = filled.mean(axis=1) >= _LEAST_FILLED
    off[~enough] = 0.0
    off -= np.nanmedian(off, axis=1, keepdims=True)
    cost = np.minimum((off / np.hypot(sigma, _DEPTH_FLOOR)) ** 2, _MOST)
    mean = np.nanmean(np.where(np.isfinite(off), cost, np.nan), axis=1)
    return np.where(enough, mean * len(at), np.nan)
