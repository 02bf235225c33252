"""The loop of `refine`, compiled: an alignment refines a score of times, on a few hundred matches
each, and most of that time went into the calls of numpy between the sums.
"""

import numpy as np
import numpy.typing as npt
from numba import njit

from fleetpose.pose_server.geometry.features.kernels import normal_equations, residuals_of

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

Side = tuple[Floats, Floats, Floats, Floats, Floats, Floats, float, float, float, Indices]
"""Lifted points that are moved into the other view: points (M, 3), sigmas of their inverse depth,
what was measured there (pixels, inverse depths, sigmas), its K, sigma of a direction here (radians)
and of a pixel there, the sign of the increment, and their rows among all matches.
"""

_SCALE_3DOF, _SCALE_2DOF = 9.0, 7.0  # compiled: a Geman-McClure weight is a quarter there
_INLIER_3DOF, _INLIER_2DOF = 14.2, 11.3  # derived: chi-square, 99.7 %
_SETTLED_SIGMAS = 0.05  # numerical: a step of less of the pose's own sigma ends the search
_CHI2_MEDIAN_1DOF = 1.4826  # derived: sigma from the median of absolute values
_LONGEST_TURN_RAD = 0.5  # numerical: of one step
_LEAST_MATCHES = 8  # compiled: of which a noise is estimated
_LEAST_WEIGHT = 0.05  # compiled: of these
_PIXEL_NOISE, _DEPTH_NOISE = 0.4, (0.25, 6.0)  # compiled: limits of what may be found

_SIDE = (
    "Tuple((f8[:, ::1], f8[::1], f8[:, ::1], f8[::1], f8[::1], f8[:, ::1], f8, f8, f8, i8[::1]))"
)
_WEIGHED = "Tuple((f8[:, ::1], f8[:, :, ::1], f8[::1], b1[::1]))"


@njit("f8[:, ::1](f8[:, ::1])", cache=True)
def _inverse(T: Floats) -> Floats:
    out = np.eye(4)
    for r in range(3):
        for c in range(3):
            out[r, c] = T[c, r]
            out[r, 3] -= T[c, r] * T[c, 3]
    return out


@njit("f8[:, ::1](f8[:, ::1], f8[::1])", cache=True)
def _retract(T: Floats, increment: Floats) -> Floats:
    """See `se3.retract`."""
    x, y, z = increment[0], increment[1], increment[2]
    angle = np.sqrt(x * x + y * y + z * z)
    a = np.sin(angle) / angle if angle > 1e-12 else 1.0
    b = (1 - np.cos(angle)) / (angle * angle) if angle > 1e-12 else 0.5
    out = np.eye(4)
    R = np.empty((3, 3))
    R[0, 0], R[0, 1], R[0, 2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    R[1, 0], R[1, 1], R[1, 2] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    R[2, 0], R[2, 1], R[2, 2] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)
    for r in range(3):
        for c in range(4):
            out[r, c] = R[r, 0] * T[0, c] + R[r, 1] * T[1, c] + R[r, 2] * T[2, c]
        out[r, 3] += increment[3 + r]
    return out


@njit(f"{_WEIGHED}({_SIDE}, {_SIDE}, i8, f8[:, ::1], f8, f8)", cache=True)
def weigh(
    forth: Side, back: Side, count: int, T: Floats, pixel: float, depth: float
) -> tuple[Floats, Floats, Floats, Bools]:
    """What a pose makes of the matches, at a noise.

    Returns:
        (M, 5) and (M, 3, 7) of `residuals_of`, robust weights (M,), and which agree (M,).
    """
    out, jacobians = np.empty((count, 5)), np.empty((count, 3, 7))
    for side, pose in ((forth, T), (back, _inverse(T))):
        X, sigma_q, uv, q, sigma_q_there, K, direction_sigma, pixel_sigma_px, sign, rows = side
        if len(rows) == 0:
            continue
        residuals_of(
            X,
            sigma_q,
            uv,
            q,
            sigma_q_there,
            pose,
            K,
            pixel * direction_sigma,
            pixel * pixel_sigma_px,
            depth,
            sign,
            rows,
            out,
            jacobians,
        )
    weights, inliers = np.zeros(count), np.zeros(count, np.bool_)
    for m in range(count):
        if out[m, 1] > 0:  # behind
            continue
        deep = out[m, 4] > 0
        weights[m] = 1.0 / (1.0 + out[m, 0] / (_SCALE_3DOF if deep else _SCALE_2DOF)) ** 2
        inliers[m] = out[m, 0] < (_INLIER_3DOF if deep else _INLIER_2DOF)
    return out, jacobians, weights, inliers


@njit("UniTuple(f8, 2)(f8, f8, f8[:, ::1], f8[::1], f8, f8)", cache=True)
def _estimated(
    pixel: float, depth: float, out: Floats, weights: Floats, stated_px: float, most: float
) -> tuple[float, float]:
    """The noise levels that make the residuals of well-weighted matches as large as expected."""
    good = weights > _LEAST_WEIGHT
    pixel = _CHI2_MEDIAN_1DOF * float(np.median(np.abs(out[:, 2][good]))) / stated_px
    deep = good & (out[:, 4] > 0)
    if deep.sum() >= _LEAST_MATCHES:
        depth *= _CHI2_MEDIAN_1DOF * float(np.median(out[:, 3][deep]))
    return (
        min(max(pixel, _PIXEL_NOISE), most),
        min(max(depth, _DEPTH_NOISE[0]), _DEPTH_NOISE[1]),
    )


@njit(
    f"Tuple((f8[:, ::1], f8, f8))({_SIDE}, {_SIDE}, i8, f8[:, ::1], f8, f8, i8, b1, f8, f8)",
    cache=True,
)
def descend(
    forth: Side,
    back: Side,
    count: int,
    T: Floats,
    pixel: float,
    depth: float,
    iterations: int,
    estimate_noise: bool,
    stated_px: float,
    most_pixel_noise: float,
) -> tuple[Floats, float, float]:
    """Robust Gauss-Newton; returns the pose and both noise levels. See `refine` for the arguments;
    `stated_px` is the sigma of a pixel's difference between both views.
    """
    for step in range(iterations):
        out, jacobians, weights, inliers = weigh(forth, back, count, T, pixel, depth)
        both = normal_equations(jacobians, weights)
        H, gradient = np.ascontiguousarray(both[:6, :6]), np.ascontiguousarray(both[:6, 6])
        trace = np.trace(H)
        if not np.isfinite(H).all() or trace <= 0:
            break
        increment = -np.linalg.solve(H + 1e-9 * trace * np.eye(6), gradient)
        norm = np.sqrt((increment[:3] ** 2).sum())
        T = _retract(T, increment * min(1.0, _LONGEST_TURN_RAD / max(norm, 1e-300)))
        if estimate_noise and step >= 1 and inliers.sum() >= _LEAST_MATCHES:
            pixel, depth = _estimated(pixel, depth, out, weights, stated_px, most_pixel_noise)
        if step >= 2 and (increment * (H @ increment)).sum() < _SETTLED_SIGMAS**2:
            break
    return T, pixel, depth
