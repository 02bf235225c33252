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

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.gauss_newton import Side, descend, weigh
from fleetpose.pose_server.geometry.features.kernels import normal_equations
from fleetpose.pose_server.geometry.features.observed import Observed

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.int64]


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
    forward = np.isfinite(j.inverse_depth[matches[:, 1]])
    backward = np.isfinite(i.inverse_depth[matches[:, 0]]) & ~forward
    order = np.flatnonzero(forward | backward)
    count = len(order)
    if count < 3:
        raise DegenerateGeometryError(f"{count} matches with a depth, need 3")
    forth = _side(j, i, matches[forward, ::-1], np.flatnonzero(forward[order]), 1.0)
    back = _side(i, j, matches[backward], np.flatnonzero(backward[order]), -1.0)
    T, pixel, depth = descend(
        forth,
        back,
        count,
        np.array(T_i_j, np.float64, order="C"),
        noise.pixel,
        noise.depth,
        iterations,
        estimate_noise,
        float(np.hypot(i.pixel_sigma_px, j.pixel_sigma_px)),
        most_pixel_noise,
    )
    final = weigh(forth, back, count, T, pixel, depth)
    return _result(T, final, NoiseScale(pixel, depth), order, len(matches))


def _side(here: Observed, there: Observed, matches: Indices, rows: Indices, sign: float) -> Side:
    """Points of one view with a depth, which are moved into the other."""
    index_here, index_there = matches.T
    return (
        here.points[index_here],
        here.inverse_depth_sigma[index_here],
        there.uv[index_there],
        there.inverse_depth[index_there],
        there.inverse_depth_sigma[index_there],
        np.array(there.K, np.float64),  # writeable, as the compiled code wants it
        here.pixel_sigma_px / here.focal_px,
        float(there.pixel_sigma_px),
        sign,
        rows,
    )


def _result(
    T: Floats,
    final: tuple[Floats, Floats, Floats, Bools],
    noise: NoiseScale,
    order: Indices,
    count: int,
) -> Refinement:
    """Puts the residuals back into the order of all matches."""
    out, jacobians, weights, inliers = final
    information = normal_equations(jacobians, inliers.astype(np.float64))[:6, :6]
    dof = int(np.where(out[inliers, 4] > 0, 3, 2).sum()) - 6
    excess = 1e3
    if inliers.any():
        excess = max(1.0, 1.15 * float(out[inliers, 0].sum()) / max(dof, 1))
    all_inliers = np.zeros(count, bool)
    all_inliers[order] = inliers
    across = np.full(count, np.inf)
    across[order] = np.abs(out[:, 2])
    return Refinement(T, information / excess, all_inliers, float(weights.sum()), noise, across)
