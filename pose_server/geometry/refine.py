"""Anisotropic refinement of a pose from matched salient points.

A point's direction is known ten to fifty times better than its depth. Each match is therefore
judged in the image and
in inverse depth, with the covariance of both points: the lifted point of one view is moved into
    the other, where its
pixel and inverse depth are compared with what was measured there. Robust Gauss-Newton with
Geman-McClure weights on Mahalanobis distances; the two noise levels are estimated anew from the
residuals.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.observed import Observed
from pose_server.geometry.se3 import hat, inverse, retract, transform

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]

_NO_DEPTH_VARIANCE = 1e6  # times the variance it replaces: the third residual then says nothing
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


@dataclass(frozen=True)
class _Residuals:
    r: Floats  # (M, 3) du, dv px and d(1/z)
    C: Floats  # (M, 3, 3)
    J: Floats  # (M, 3, 6) by the left increment of T_i_j
    with_depth: Bools
    behind: Bools
    across: Floats
    depth_sigma_ratio: Floats  # |d(1/z)| over its sigma


def refine(
    i: Observed,
    j: Observed,
    matches: Indices,
    T_i_j: Floats,
    noise: NoiseScale = NoiseScale(),
    iterations: int = 8,
    estimate_noise: bool = True,
) -> Refinement:
    """Refines T_i_j on matches (M, 2) of salient points of which at least one has a depth.

    With zero iterations it only scores the pose given.

    Raises:
        DegenerateGeometryError: fewer than three matches with depth.
    """
    usable = np.isfinite(i.inverse_depth[matches[:, 0]]) | np.isfinite(
        j.inverse_depth[matches[:, 1]]
    )
    if usable.sum() < 3:
        raise DegenerateGeometryError(f"{int(usable.sum())} matches with a depth, need 3")
    forward = np.isfinite(j.inverse_depth[matches[:, 1]])
    backward = usable & ~forward
    T = T_i_j
    for step in range(iterations):
        weighed = _weigh(_joined(i, j, matches, forward, backward, T, noise))
        increment = weighed.step()
        if increment is None:
            break
        norm = np.linalg.norm(increment[:3])
        T = retract(T, increment if norm < 0.5 else increment * (0.5 / norm))
        if estimate_noise and step >= 1 and weighed.inliers.sum() >= 8:
            noise = _estimated(noise, weighed, i, j)
        if step >= 2 and weighed.length2(increment) < _SETTLED_SIGMAS**2:
            break
    final = _weigh(_joined(i, j, matches, forward, backward, T, noise))
    order = np.concatenate((np.nonzero(forward)[0], np.nonzero(backward)[0]))
    return _result(T, final, noise, order, len(matches))


@dataclass(frozen=True)
class _Weighed:
    """Residuals with their Mahalanobis distances and robust weights."""

    residuals: _Residuals
    distance: Floats
    weights: Floats
    inliers: Bools
    WJ: Floats

    def length2(self, increment: Floats) -> float:
        """Squared length of an increment (6,) in sigmas of the pose."""
        moved = np.einsum("mki,i->mk", self.residuals.J, increment)
        along = np.einsum("mki,i->mk", self.WJ, increment)
        return float(np.einsum("m,mk,mk->", self.weights, moved, along))

    def step(self) -> Floats | None:
        """The Gauss-Newton increment (6,), or None where the matches say nothing."""
        H = np.einsum("m,mki,mkj->ij", self.weights, self.residuals.J, self.WJ)
        if not np.isfinite(H).all() or np.trace(H) <= 0:
            return None
        gradient = np.einsum("m,mki,mk->i", self.weights, self.WJ, self.residuals.r)
        return -np.linalg.solve(H + 1e-9 * np.trace(H) * np.eye(6), gradient)


def _weigh(residuals: _Residuals) -> _Weighed:
    W = np.linalg.inv(residuals.C)
    distance = np.einsum("mk,mkl,ml->m", residuals.r, W, residuals.r)
    scale = np.where(residuals.with_depth, _SCALE_3DOF, _SCALE_2DOF)
    weights = np.where(residuals.behind, 0.0, 1.0 / (1.0 + distance / scale) ** 2)
    limit = np.where(residuals.with_depth, _INLIER_3DOF, _INLIER_2DOF)
    inliers = (distance < limit) & ~residuals.behind
    return _Weighed(residuals, distance, weights, inliers, W @ residuals.J)


def _result(
    T: Floats, final: _Weighed, noise: NoiseScale, order: Indices, count: int
) -> Refinement:
    """Puts the residuals back into the order of the matches; `order` names them as they were
    stacked.
    """
    inliers = final.inliers
    information = np.einsum("mki,mkj->ij", final.residuals.J[inliers], final.WJ[inliers])
    dof = int(np.where(final.residuals.with_depth, 3, 2)[inliers].sum()) - 6
    excess = 1e3
    if inliers.any():
        excess = max(1.0, 1.15 * float(final.distance[inliers].sum()) / max(dof, 1))
    all_inliers = np.zeros(count, bool)
    all_inliers[order] = inliers
    across = np.full(count, np.inf)
    across[order] = np.abs(final.residuals.across)
    return Refinement(
        T, information / excess, all_inliers, float(final.weights.sum()), noise, across
    )


def _joined(
    i: Observed,
    j: Observed,
    matches: Indices,
    forward: Bools,
    backward: Bools,
    T: Floats,
    noise: NoiseScale,
) -> _Residuals:
    parts = []
    if forward.any():
        m = matches[forward]
        parts.append(_moved(j, i, m[:, 1], m[:, 0], T, noise, sign=1))
    if backward.any():
        m = matches[backward]
        parts.append(_moved(i, j, m[:, 0], m[:, 1], inverse(T), noise, sign=-1))
    return _Residuals(
        *(
            np.concatenate([getattr(p, name) for p in parts])
            for name in _Residuals.__dataclass_fields__
        )
    )


def _moved(
    source: Observed,
    target: Observed,
    index_source: Indices,
    index_target: Indices,
    T: Floats,
    noise: NoiseScale,
    sign: int,
) -> _Residuals:
    """Residuals of the source's lifted points in the target view.

    `T` is T_target_source. The Jacobian is by the left increment of T (sign 1), or of its inverse
    (sign -1).
    """
    R = T[:3, :3]
    X = source.points[index_source]
    Y = transform(T, X)
    near = np.median(X[:, 2]) * 1e-3
    behind = Y[:, 2] <= near
    z = np.maximum(Y[:, 2], near)
    fx, fy = target.K[0, 0], target.K[1, 1]
    uv, q = target.uv[index_target], target.inverse_depth[index_target]
    has_depth = np.isfinite(q)
    r = np.column_stack(
        (
            fx * Y[:, 0] / z + target.K[0, 2] - uv[:, 0],
            fy * Y[:, 1] / z + target.K[1, 2] - uv[:, 1],
            np.where(has_depth, 1.0 / z - q, 0.0),
        )
    )
    JP = np.zeros((len(z), 3, 3))  # of (u, v, 1/z) by the point in the target frame
    JP[:, 0, 0], JP[:, 0, 2] = fx / z, -fx * Y[:, 0] / z**2
    JP[:, 1, 1], JP[:, 1, 2] = fy / z, -fy * Y[:, 1] / z**2
    JP[:, 2, 2] = -1.0 / z**2
    JR = JP @ R
    ray = X / X[:, 2:3]
    along = noise.depth * source.inverse_depth_sigma[index_source] * X[:, 2] ** 2
    across = noise.pixel * source.pixel_sigma_px * X[:, 2] / source.focal_px
    C_source = (across**2)[:, None, None] * np.eye(3)
    C_source = C_source + (along**2)[:, None, None] * ray[:, :, None] * ray[:, None, :]
    C = JR @ C_source @ JR.transpose(0, 2, 1)
    C[:, 0, 0] += (noise.pixel * target.pixel_sigma_px) ** 2
    C[:, 1, 1] += (noise.pixel * target.pixel_sigma_px) ** 2
    sigma_q = np.where(has_depth, noise.depth * target.inverse_depth_sigma[index_target], 0.0)
    C[:, 2, 2] = np.where(has_depth, C[:, 2, 2] + sigma_q**2, C[:, 2, 2] * _NO_DEPTH_VARIANCE)
    eye = np.broadcast_to(np.eye(3), (len(z), 3, 3))
    if sign > 0:
        J = JP @ np.concatenate((-hat(Y), eye), axis=2)
    else:
        J = JR @ np.concatenate((hat(X), -eye), axis=2)
    epipolar = np.einsum("mij,mj->mi", JR, ray)[:, :2]
    epipolar /= np.maximum(np.linalg.norm(epipolar, axis=1, keepdims=True), 1e-9)
    off_line = -epipolar[:, 1] * r[:, 0] + epipolar[:, 0] * r[:, 1]
    ratio = np.abs(r[:, 2]) / np.sqrt(C[:, 2, 2])
    return _Residuals(r, C, J, has_depth, behind, off_line, ratio)


def _estimated(noise: NoiseScale, weighed: _Weighed, i: Observed, j: Observed) -> NoiseScale:
    """The noise levels that make the residuals of well-weighted matches as large as expected."""
    residuals = weighed.residuals
    good = weighed.weights > 0.05
    stated = np.hypot(i.pixel_sigma_px, j.pixel_sigma_px)
    pixel = _CHI2_MEDIAN_1DOF * float(np.median(np.abs(residuals.across[good]))) / stated
    deep = good & residuals.with_depth
    depth = noise.depth
    if deep.sum() >= 8:
        depth *= _CHI2_MEDIAN_1DOF * float(np.median(residuals.depth_sigma_ratio[deep]))
    return NoiseScale(float(np.clip(pixel, 0.4, 4.0)), float(np.clip(depth, 0.25, 6.0)))
