"""Anisotropic refinement of a pose from matched salient points.

A point's direction is known ten to fifty times better than its depth. Each match is therefore
judged in the image and in inverse depth, with the covariance of both points: the lifted point of
one view is moved into the other, where its pixel and inverse depth are compared with what was
measured there. Robust Gauss-Newton with Geman-McClure weights on Mahalanobis distances; the two
noise levels are estimated anew from the residuals.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.kernels import normal_equations, residuals_of
from pose_server.geometry.observed import Observed
from pose_server.geometry.se3 import inverse, retract

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

_SCALE_3DOF, _SCALE_2DOF = 9.0, 7.0  # where a Geman-McClure weight has fallen to a quarter
_INLIER_3DOF, _INLIER_2DOF = 14.2, 11.3  # chi-square, 99.7 %
_SETTLED_SIGMAS = 0.05  # a step of less than this share of the pose's own sigma ends the search
_CHI2_MEDIAN_1DOF = 1.4826  # sigma from the median of absolute values


@dataclass(frozen=True)
class NoiseScale:
    """By what factor the noise of a pair differs from what the cameras state."""

    pixel: float = 1.0
    depth: float = 1.0


@dataclass(frozen=True)
class Refinement:
    """A refined pose and how well the matches determine it.

    Attributes:
        T_i_j: (4, 4) camera j in camera i.
        information: (6, 6) of left perturbations, rotation first, inflated where residuals exceed
            the noise.
        inliers: (M,) which matches agree.
        support: sum of the robust weights.
        noise: the noise found.
        across_px: (M,) residuals across the epipolar lines, px: what no depth error can explain.
    """

    T_i_j: Floats
    information: Floats
    inliers: Bools
    support: float
    noise: NoiseScale
    across_px: Floats


def refine(
    i: Observed,
    j: Observed,
    matches: Indices,
    T_i_j: Floats,
    noise: NoiseScale = NoiseScale(),
    iterations: int = 8,
    estimate_noise: bool = True,
    most_pixel_noise: float = 4.0,
) -> Refinement:
    """Refines T_i_j on matches (M, 2) of salient points of which at least one has a depth.

    With zero iterations it only scores the pose given.

    Args:
        i, j: the salient points.
        matches: of which some may be wrong.
        T_i_j: where to begin.
        noise: to begin with.
        iterations: at most.
        estimate_noise: whether the noise is found anew.
        most_pixel_noise: the largest scale of the pixels' noise that may be found. Among wrong
            matches around predicted places a wide one confirms any pose.

    Raises:
        DegenerateGeometryError: fewer than three matches with depth.
    """
    problem = _Problem(i, j, matches)
    if len(problem.order) < 3:
        raise DegenerateGeometryError(f"{len(problem.order)} matches with a depth, need 3")
    T = T_i_j
    for step in range(iterations):
        weighed = _weigh(problem, T, noise)
        H, gradient = weighed.equations()
        if not np.isfinite(H).all() or np.trace(H) <= 0:
            break
        increment = -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(6), gradient)
        norm = np.linalg.norm(increment[:3])
        T = retract(T, increment if norm < 0.5 else increment * (0.5 / norm))
        if estimate_noise and step >= 1 and weighed.inliers.sum() >= 8:
            noise = _estimated(noise, weighed, i, j, most_pixel_noise)
        if step >= 2 and increment @ H @ increment < _SETTLED_SIGMAS**2:
            break
    return _result(T, _weigh(problem, T, noise), noise, problem.order, len(matches))


class _Problem:
    """The matches of two views by the way they are compared: points of j with a depth are moved
    into i, and where there is none, points of i into j.

    Attributes:
        order: (M',) which matches can be used.
    """

    def __init__(self, i: Observed, j: Observed, matches: Indices) -> None:
        forward = np.isfinite(j.inverse_depth[matches[:, 1]])
        backward = np.isfinite(i.inverse_depth[matches[:, 0]]) & ~forward
        self.order = np.flatnonzero(forward | backward)
        self._sides = (
            _Side(j, i, matches[forward, ::-1], np.flatnonzero(forward[self.order]), 1.0),
            _Side(i, j, matches[backward], np.flatnonzero(backward[self.order]), -1.0),
        )

    def at(self, T_i_j: Floats, noise: NoiseScale) -> tuple[Floats, Floats]:
        """See `residuals_of`: (M', 5) and (M', 3, 7)."""
        out, jacobians = np.empty((len(self.order), 5)), np.empty((len(self.order), 3, 7))
        for side, T in zip(self._sides, (T_i_j, inverse(T_i_j)), strict=True):
            side.residuals(T, noise, out, jacobians)
        return out, jacobians


class _Side:
    """Lifted points of one view that are moved into the other, and what was measured there."""

    def __init__(
        self, here: Observed, there: Observed, matches: Indices, rows: Indices, sign: float
    ) -> None:
        index_here, index_there = matches.T
        self._points = here.points[index_here], here.inverse_depth_sigma[index_here]
        self._measured = (
            there.uv[index_there],
            there.inverse_depth[index_there],
            there.inverse_depth_sigma[index_there],
        )
        self._K = np.array(there.K)  # writeable, as the compiled code wants it
        self._direction_sigma = here.pixel_sigma_px / here.focal_px
        self._pixel_sigma_px = there.pixel_sigma_px
        self._rows, self._sign = rows, sign

    def residuals(self, T: Floats, noise: NoiseScale, out: Floats, jacobians: Floats) -> None:
        """Writes its rows."""
        if len(self._rows) == 0:
            return
        residuals_of(
            *self._points,
            *self._measured,
            np.ascontiguousarray(T),
            self._K,
            noise.pixel * self._direction_sigma,
            noise.pixel * self._pixel_sigma_px,
            noise.depth,
            self._sign,
            self._rows,
            out,
            jacobians,
        )


@dataclass(frozen=True)
class _Weighed:
    """Residuals in sigmas with their robust weights: (M,) each, and whitened Jacobians with the
    residual in the last column (M, 3, 7).
    """

    jacobians: Floats
    squared: Floats
    weights: Floats
    inliers: Bools
    across: Floats
    depth_ratio: Floats
    with_depth: Bools

    def equations(self) -> tuple[Floats, Floats]:
        """H (6, 6) and the gradient (6,)."""
        both = normal_equations(self.jacobians, self.weights)
        return both[:6, :6], both[:6, 6]


def _weigh(problem: _Problem, T: Floats, noise: NoiseScale) -> _Weighed:
    out, jacobians = problem.at(T, noise)
    squared, across, depth_ratio = out[:, 0], out[:, 2], out[:, 3]
    behind, with_depth = out[:, 1] > 0, out[:, 4] > 0
    scale = np.where(with_depth, _SCALE_3DOF, _SCALE_2DOF)
    weights = np.where(behind, 0.0, 1.0 / (1.0 + squared / scale) ** 2)
    inliers = (squared < np.where(with_depth, _INLIER_3DOF, _INLIER_2DOF)) & ~behind
    return _Weighed(jacobians, squared, weights, inliers, across, depth_ratio, with_depth)


def _result(
    T: Floats, final: _Weighed, noise: NoiseScale, order: Indices, count: int
) -> Refinement:
    """Puts the residuals back into the order of all matches."""
    inliers = final.inliers
    information = normal_equations(final.jacobians, inliers.astype(np.float64))[:6, :6]
    dof = int(np.where(final.with_depth, 3, 2)[inliers].sum()) - 6
    excess = 1e3
    if inliers.any():
        excess = max(1.0, 1.15 * float(final.squared[inliers].sum()) / max(dof, 1))
    all_inliers = np.zeros(count, bool)
    all_inliers[order] = inliers
    across = np.full(count, np.inf)
    across[order] = np.abs(final.across)
    return Refinement(
        T, information / excess, all_inliers, float(final.weights.sum()), noise, across
    )


def _estimated(
    noise: NoiseScale, weighed: _Weighed, i: Observed, j: Observed, most: float
) -> NoiseScale:
    """The noise levels that make the residuals of well-weighted matches as large as expected."""
    good = weighed.weights > 0.05
    stated = np.hypot(i.pixel_sigma_px, j.pixel_sigma_px)
    pixel = _CHI2_MEDIAN_1DOF * float(np.median(np.abs(weighed.across[good]))) / stated
    deep = good & weighed.with_depth
    depth = noise.depth
    if deep.sum() >= 8:
        depth *= _CHI2_MEDIAN_1DOF * float(np.median(weighed.depth_ratio[deep]))
    return NoiseScale(float(np.clip(pixel, 0.4, most)), float(np.clip(depth, 0.25, 6.0)))
