"""How the right camera really stands, from matches alone: a fit of the epipolar geometry.

Six numbers: the rotation of the rectified right camera (3), the direction of the baseline (2), and
the ratio of both focal lengths. What each does to a match at x, y (px over focal length) with
disparity d, to first order: pitch moves rows by 1 + y^2, roll by x, yaw by x y, a baseline that
points down by d, one that points forward by y d, a focal length by y. So a yaw, which shifts all
disparities, is seen in the corners alone, and only by its sigma can it be told how well.

Sigmas are those of a robust sandwich with one cluster per tile of the image (Cameron and Miller,
Journal of Human Resources 2015): neighbouring matches, and those of the next image of a robot that
stands still, are off by the same, so that many of them must not count as many.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.checking.matching import Matches

Floats = npt.NDArray[np.float64]

COLUMNS, ROWS = 8, 6  # tiles
_PRIOR_SIGMA = np.array([0.3, 0.3, 0.3, 0.2, 0.2, 0.1])  # rad, and log of the focal lengths' ratio
_TUKEY = 4.685  # 95 % efficiency for Gaussian errors
_SCALE_FLOOR_PX = 0.05
_TILE_BIAS_PX = (
    0.05  # of all matches of a tile: SIFT is not better than that however many there are
)
_ROUNDS = 30
_STEP = 1e-6


@dataclass(frozen=True)
class Fit:
    """What the matches say of the rectified rig, and how surely.

    Attributes:
        theta: (6,) rotation vector of the right camera, rad; y and z of the baseline's direction
            over its x; log of the right focal length over the left one. Zeros: as calibrated.
        covariance: (6, 6) of it.
        inliers: (M,) which matches it explains.
        rows_before_px, rows_after_px: (M,) how much lower than it should the right image shows
            each match, by the calibration and by the fit.
        tiles: (M,) the tile of each match.
    """

    theta: Floats
    covariance: Floats
    inliers: npt.NDArray[np.bool_]
    rows_before_px: Floats
    rows_after_px: Floats
    tiles: npt.NDArray[np.intp]


def fit_rig(matches: Matches, K: Floats, size: tuple[int, int]) -> Fit:
    """Robust Gauss-Newton from the calibration.

    Args:
        matches: in rectified images.
        K: (3, 3) their intrinsics.
        size: their width, height, px.
    """
    left, right = (rays_of(uv, K) for uv in (matches.left, matches.right))
    theta = np.zeros(6)
    prior = np.diag(1 / _PRIOR_SIGMA**2)
    scale = _SCALE_FLOOR_PX
    for _ in range(_ROUNDS):
        rows = row_errors(theta, left, right, K)
        scale = max(1.4826 * float(np.median(np.abs(rows))), _SCALE_FLOOR_PX)
        weight = _tukey(rows / scale)
        J = jacobian(lambda t: row_errors(t, left, right, K), theta)
        H = (J.T * weight) @ J + scale**2 * prior
        step = np.linalg.solve(H, (J.T * weight) @ rows + scale**2 * prior @ theta)
        theta = theta - step
        if np.abs(step).max() < 1e-8:
            break
    rows = row_errors(theta, left, right, K)
    weight = _tukey(rows / scale)
    J = jacobian(lambda t: row_errors(t, left, right, K), theta)
    tiles = _tiles(matches.left, size)
    covariance = _sandwich(J, weight, rows, tiles, scale**2 * prior, scale)
    before = row_errors(np.zeros(6), left, right, K)
    return Fit(theta, covariance, weight > 0, before, rows, tiles)


def _sandwich(
    J: Floats,
    weight: Floats,
    rows: Floats,
    tiles: npt.NDArray[np.intp],
    ridge: Floats,
    scale: float,
) -> Floats:
    """Covariance (6, 6) from the scatter of whole tiles, and what all of a tile may be off by."""
    # the derivative of Tukey's influence: with the weights alone sigmas come out a fifth too small
    curvature = np.where(weight > 0, np.sqrt(weight) * (5 * np.sqrt(weight) - 4), 0.0)
    bread = np.linalg.inv((J.T * curvature) @ J + ridge)
    scores, leverage = np.zeros((2, COLUMNS * ROWS, 6))
    np.add.at(scores, tiles, J * (weight * rows)[:, None])
    np.add.at(leverage, tiles, J * weight[:, None])
    clusters = max(len(np.unique(tiles[weight > 0])), 2)
    meat = scores.T @ scores * clusters / (clusters - 1)
    meat += _TILE_BIAS_PX**2 * leverage.T @ leverage + scale**2 * ridge
    return bread @ meat @ bread


def rays_of(uv: Floats, K: Floats) -> Floats:
    """(M, 3) directions with z = 1 of pixels (M, 2)."""
    uv1 = np.column_stack((uv, np.ones(len(uv))))
    return uv1 @ np.linalg.inv(K).T


def pose_of(theta: Floats) -> tuple[Floats, Floats]:
    """Rotation (3, 3) and unit translation (3,) of rectified left to rectified right."""
    R = np.asarray(cv2.Rodrigues(theta[:3])[0], np.float64)
    t = np.array((-1.0, theta[3], theta[4]))
    return R, t / np.linalg.norm(t)


def row_errors(theta: Floats, left: Floats, right: Floats, K: Floats) -> Floats:
    """(M,) px between both images across the epipolar lines, positive where the right one shows
    a match too low: Sampson's distance, times the root of 2, as both images share the error.
    """
    R, t = pose_of(theta)
    right = _unzoomed(right, theta[5])
    lines = (left @ R.T) @ _cross(t).T  # E x_left
    back = right @ _cross(t) @ R  # E^T x_right
    norm = np.sqrt((lines[:, :2] ** 2).sum(1) + (back[:, :2] ** 2).sum(1))
    return np.sqrt(2) * K[1, 1] * (right * lines).sum(1) / np.maximum(norm, 1e-9)


def inverse_depths(theta: Floats, left: Floats, right: Floats) -> Floats:
    """(M,) baselines over depth of each match; negative behind the cameras."""
    R, t = pose_of(theta)
    right = _unzoomed(right, theta[5])
    ahead, aside = np.cross(right, left @ R.T), np.cross(right, t)
    return -(ahead * aside).sum(1) / np.maximum((aside**2).sum(1), 1e-12)


def jacobian(function, theta: Floats) -> Floats:  # noqa: ANN001  any array of a vector
    """(M, P) derivatives of a function (P,) -> (M,), central differences."""
    steps = _STEP * np.eye(len(theta))
    return np.stack(
        [(function(theta + d) - function(theta - d)) / (2 * _STEP) for d in steps], axis=-1
    )


def _unzoomed(right: Floats, log_ratio: float) -> Floats:
    return right * np.array((np.exp(-log_ratio), np.exp(-log_ratio), 1.0))


def _cross(t: Floats) -> Floats:
    return np.array(((0, -t[2], t[1]), (t[2], 0, -t[0]), (-t[1], t[0], 0)))


def _tukey(ratio: Floats) -> Floats:
    return np.where(np.abs(ratio) < _TUKEY, (1 - (ratio / _TUKEY) ** 2) ** 2, 0.0)


def _tiles(uv: Floats, size: tuple[int, int]) -> npt.NDArray[np.intp]:
    column = np.clip((uv[:, 0] / size[0] * COLUMNS).astype(np.intp), 0, COLUMNS - 1)
    row = np.clip((uv[:, 1] / size[1] * ROWS).astype(np.intp), 0, ROWS - 1)
    return row * COLUMNS + column
