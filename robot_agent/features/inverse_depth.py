"""Inverse depth at salient points, from depth images, disparity images or scattered points.

A salient point sits between the cloud's pixels, often beside a depth edge. Its depth comes from a
plane fitted in inverse depth, where planes of the world are planes of the image, and only from the
neighbours on its own surface: those whose inverse depth differs from the reference's by no more
than noise and a steep plane explain. Nothing is averaged across.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.messages import Camera
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, Ranges, ScatteredPoints

Floats = npt.NDArray[np.float64]

WINDOW_RADIUS = 2  # 5 x 5 cells of an organised image
NEIGHBOURS = 12  # of scattered points
DENSE_POINTS = 10_000  # more scattered points than this are a surface, fewer are single points
SPARSE_REACH_PX = 2.0
OWN_DEPTH_PX = 0.75  # a cloud point this near to a salient point is that very point
STEEPEST_SLOPE = 1.73  # tangent of 60 deg; what leans away more counts as an edge
USUAL_SLOPE = 1.0  # 45 deg
NOISE_SIGMAS = 3.0
SLOPE_RIDGE_PX2 = 2.0  # keeps the plane flat where neighbours lie on a line or on one side


@dataclass(frozen=True)
class Lifted:
    """Inverse depth (N,) and its sigma (N,), both 1/m, nan where there is none."""

    inverse_depth: Floats
    sigma: Floats


@dataclass(frozen=True)
class Neighbours:
    """K candidates around each of N points; K comes first, so that sums over it run along memory.

    Attributes:
        x: (K, N) from the point to the candidate, full-resolution pixels.
        y: (K, N) likewise.
        inverse_depth: (K, N) 1/m, nan where there is no candidate.
        reference: (N,) 1/m, of the surface the point is on; nan where the point gets no depth.
    """

    x: Floats
    y: Floats
    inverse_depth: Floats
    reference: Floats


def lift_points(uv: Floats, ranges: Ranges, model: Camera) -> Lifted:
    """Inverse depths at pixels (N, 2) of the full-resolution image."""
    if isinstance(ranges, ScatteredPoints):
        around = _scattered_neighbours(uv, ranges, model)
    else:
        around = _grid_neighbours(uv, ranges, model)
    known = np.flatnonzero(np.isfinite(around.reference))
    result = Lifted(np.full(len(uv), np.nan), np.full(len(uv), np.nan))
    value, sigma = _plane_at(_only(around, known), model)
    positive = value > 0
    result.inverse_depth[known] = np.where(positive, value, np.nan)
    result.sigma[known] = np.where(positive, sigma, np.nan)
    return result


def sigma_of(inverse_depth: Floats, model: Camera) -> Floats:
    """Sigma of single measurements of inverse depth, 1/m: sigma(z) / z^2."""
    c0, c1, c2 = model.noise.depth_sigma_m
    return (c0 * inverse_depth + c1) * inverse_depth + c2


def _only(around: Neighbours, chosen: npt.NDArray[np.intp]) -> Neighbours:
    return Neighbours(
        around.x[:, chosen],
        around.y[:, chosen],
        around.inverse_depth[:, chosen],
        around.reference[chosen],
    )


def _grid_neighbours(uv: Floats, ranges: DepthImage | DisparityImage, model: Camera) -> Neighbours:
    """The cells around each point; one whose own cell is empty gets no depth near edges."""
    image = ranges.depth_m if isinstance(ranges, DepthImage) else ranges.disparity_px
    height, width = image.shape
    scale = model.width // width
    u, v = (uv.T + 0.5) / scale - 0.5
    window = np.arange(-WINDOW_RADIUS, WINDOW_RADIUS + 1)
    dy, dx = (d.reshape(-1, 1) for d in np.meshgrid(window, window, indexing="ij"))
    column = np.rint(u).astype(np.intp) + dx
    row = np.rint(v).astype(np.intp) + dy
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    measured = image[np.where(inside, row, 0), np.where(inside, column, 0)].astype(np.float64)
    measured[~(inside & (measured > 0) & (measured < np.inf))] = np.nan
    if isinstance(ranges, DepthImage):
        q = 1.0 / measured
    else:
        q = measured / ranges.focal_baseline_px_m
    x, y = (column - u) * scale, (row - v) * scale
    nearest = np.where(np.isnan(q), np.inf, x * x + y * y).argmin(axis=0)
    reference = q[nearest, np.arange(len(uv))]
    around = Neighbours(x, y, q, reference)
    straddles = (~np.isnan(q) & ~_same_surface(around, model)).any(axis=0)
    empty = np.isnan(q[len(q) // 2])
    reference[empty & straddles] = np.nan
    return around


def _scattered_neighbours(uv: Floats, ranges: ScatteredPoints, model: Camera) -> Neighbours:
    """The nearest points; the first few must share a surface, unless one is the very point."""
    count = min(NEIGHBOURS, len(ranges.z))
    if count == 0 or len(uv) == 0:
        nothing = np.full((1, len(uv)), np.nan)
        return Neighbours(nothing, nothing, nothing, nothing[0])
    tree = cv2.flann.Index(  # exact search in one kd-tree
        np.ascontiguousarray(ranges.uv, np.float32), {"algorithm": 4, "leaf_max_size": 12}
    )
    found, squared = tree.knnSearch(np.ascontiguousarray(uv, np.float32), count, params={})
    found, distance = np.asarray(found.T, np.intp), np.sqrt(squared.T)
    reach = _reach_px(ranges, tree)
    x, y = (ranges.uv[found, axis] - uv[:, axis] for axis in (0, 1))
    q = 1.0 / ranges.z[found]
    reference = np.median(q[:3], axis=0)
    own = distance[0] < OWN_DEPTH_PX
    reference[own] = q[0, own]
    q[distance > np.maximum(3 * reach, distance[0] + 1)] = np.nan
    around = Neighbours(x, y, q, reference)
    few = _only_nearest(around, 4)
    agree = _same_surface(few, model).sum(axis=0) > 0.7 * (~np.isnan(few.inverse_depth)).sum(axis=0)
    reference[(distance[0] > reach) | ~(own | agree)] = np.nan
    return around


def _only_nearest(around: Neighbours, count: int) -> Neighbours:
    return Neighbours(
        around.x[:count], around.y[:count], around.inverse_depth[:count], around.reference
    )


def _reach_px(ranges: ScatteredPoints, tree: "cv2.flann.Index") -> float:
    """How far from its nearest cloud point a salient point may lie and still get a depth."""
    if len(ranges.z) <= DENSE_POINTS:
        return SPARSE_REACH_PX
    sample = np.ascontiguousarray(ranges.uv[:: len(ranges.uv) // 1000], np.float32)
    _, squared = tree.knnSearch(sample, 2, params={})
    return max(SPARSE_REACH_PX, 2 * float(np.sqrt(np.median(squared[:, 1]))))


def _same_surface(around: Neighbours, model: Camera) -> npt.NDArray[np.bool_]:
    """Whether candidates (K, N) can lie on one plane with the reference, given their noise."""
    noise = NOISE_SIGMAS * np.sqrt(2) * sigma_of(around.reference, model)
    slope = STEEPEST_SLOPE / model.K[0, 0] * around.reference
    distance = np.hypot(around.x, around.y)
    return np.abs(around.inverse_depth - around.reference) <= noise + slope * distance


def _plane_at(around: Neighbours, model: Camera) -> tuple[Floats, Floats]:
    """Value and sigma, at the point, of a plane through the neighbours on its surface."""
    x, y = around.x, around.y
    on_surface = _same_surface(around, model)
    weight = on_surface / (x * x + y * y + 1.0)
    difference = np.where(on_surface, around.inverse_depth - around.reference, 0.0)
    wx, wy = weight * x, weight * y
    # the normal equations [[s, sx, sy], [sx, sxx, sxy], [sy, sxy, syy]], slopes held back by a
    # ridge
    s, sx, sy = weight.sum(0), wx.sum(0), wy.sum(0)
    sxx, sxy, syy = (wx * x).sum(0), (wx * y).sum(0), (wy * y).sum(0)
    sxx += SLOPE_RIDGE_PX2
    syy += SLOPE_RIDGE_PX2
    d, dx, dy = (weight * difference).sum(0), (wx * difference).sum(0), (wy * difference).sum(0)
    # their inverse, by cofactors
    c00, c01, c02 = sxx * syy - sxy**2, sxy * sy - sx * syy, sx * sxy - sxx * sy
    c11, c12, c22 = s * syy - sy**2, sx * sy - s * sxy, s * sxx - sx**2
    determinant = s * c00 + sx * c01 + sy * c02
    offset = (c00 * d + c01 * dx + c02 * dy) / determinant
    slope_x = (c01 * d + c11 * dx + c12 * dy) / determinant
    slope_y = (c02 * d + c12 * dx + c22 * dy) / determinant
    residual = difference - offset - slope_x * x - slope_y * y
    spread = np.sqrt((weight * residual**2).sum(0) / s)
    # how each neighbour counts for the value; they share their errors: averaging earns nothing
    share = weight * (c00 + c01 * x + c02 * y) / determinant
    leverage = np.sqrt((share**2).sum(0))
    sigma = np.maximum(sigma_of(around.reference, model) * np.maximum(leverage, 1.0), spread)
    across = np.hypot(slope_x, slope_y) * model.noise.pixel_sigma_px
    # neighbours on one side leave the slope to the ridge, which misses a usual slope by so much
    lever_px = SLOPE_RIDGE_PX2 * np.hypot(c01, c02) / determinant
    missed = lever_px * USUAL_SLOPE / model.K[0, 0] * around.reference
    return around.reference + offset, np.sqrt(sigma**2 + across**2 + missed**2)
