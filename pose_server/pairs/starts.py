"""The operator's start: a pose from the correspondences alone, with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pose_server.geometry import dlt
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.evidence import agreement
from pose_server.geometry.noise import covariances
from pose_server.geometry.observed import Observed
from pose_server.geometry.refine import NoiseScale, Refinement, refine
from pose_server.geometry.se3 import position_covariance
from pose_server.pairs.align import Start
from pose_server.pairs.judging import PairResult
from pose_server.pairs.views import PreparedView

Floats = npt.NDArray[np.floating]

CLICK_SIGMA_PX = 2.0  # of a person's click, in either image
_FULL_POSE = 3  # correspondences that determine a pose
_MAX_SEEN_THROUGH = 0.25


@dataclass(frozen=True)
class Clicks:
    """Correspondences between two views: (N, 2) pixels, (N,) depths along the optical axis and
    their sigmas, metres.
    """

    uv_i: Floats
    uv_j: Floats
    z_i: Floats
    z_j: Floats
    sigma_i: Floats
    sigma_j: Floats


@dataclass(frozen=True)
class OperatorStart:
    """A start from clicks; `covariance` only where they determine a full pose."""

    start: Start
    covariance: Floats | None
    inliers: npt.NDArray[np.bool_]
    model: str


def operator_start(
    i: PreparedView, j: PreparedView, clicks: Clicks, others: Sequence[Start]
) -> OperatorStart | None:
    """DLT on the clicks, then anisotropic refinement where they determine a full pose.

    One or two clicks give a translation only; the rotation comes from the best other start,
    without one there is none.
    """
    observed_i = _observed(i, clicks.uv_i, clicks.z_i, clicks.sigma_i)
    observed_j = _observed(j, clicks.uv_j, clicks.z_j, clicks.sigma_j)
    p_i, p_j = observed_i.points, observed_j.points
    known = min(others, key=lambda start: start.sigma, default=None)
    depth = 0.5 * (i.median_depth_m + j.median_depth_m)
    try:
        fit = dlt.fit(
            p_i, p_j, None if known is None else known.T_i_j[:3, :3], _inlier_m(i, j, p_i, p_j)
        )
    except DegenerateGeometryError:
        return None
    if fit.model == "translation":
        if known is None:
            return None
        return OperatorStart(
            Start("operator", fit.T_a_b, max(known.sigma, 0.03)), None, fit.inliers, fit.model
        )
    index = np.nonzero(fit.inliers)[0]
    refined = refine(
        observed_i,
        observed_j,
        np.column_stack((index, index)),
        fit.T_a_b,
        NoiseScale(),
        estimate_noise=False,
    )
    covariance = _covariance(refined)
    if covariance is None:
        return None
    sigma = (
        float(np.sqrt(np.linalg.eigvalsh(position_covariance(refined.T_i_j, covariance))[-1]))
        / depth
    )
    start = Start("operator", refined.T_i_j, float(np.clip(sigma, 0.005, 0.06)))
    return OperatorStart(start, covariance, fit.inliers, fit.model)


def with_operator_fallback(
    result: PairResult, operator: OperatorStart | None, i: PreparedView, j: PreparedView
) -> PairResult:
    """Where features cannot confirm a pose that three clicks determine, the clicks' own pose is
    plausible.

    Unless the world contradicts it: the moved cloud is seen through.
    """
    if operator is None or operator.covariance is None or operator.inliers.sum() < _FULL_POSE:
        return result
    if result.verdict in ("verified", "plausible"):
        return result
    seen = agreement(i.surface, j.surface, operator.start.T_i_j)
    if seen.through > _MAX_SEEN_THROUGH:
        reason = f"{seen.through:.0%} of the cloud moved by the correspondences is seen through"
        return replace(result, reasons=(*result.reasons, reason))
    return replace(
        result,
        T_i_j=operator.start.T_i_j,
        covariance=operator.covariance,
        verdict="plausible",
        reasons=(f"by {int(operator.inliers.sum())} correspondences alone", *result.reasons),
        overlap=seen.overlap,
        start="operator",
    )


def _observed(view: PreparedView, uv: Floats, z: Floats, sigma: Floats) -> Observed:
    return Observed(view.observed.K, view.observed.size, uv, 1.0 / z, sigma / z**2, CLICK_SIGMA_PX)


def _inlier_m(i: PreparedView, j: PreparedView, p_i: Floats, p_j: Floats) -> float:
    """Three sigma of a click's distance to its counterpart, over the median click."""
    total = 0.0
    for view, points in ((i, p_i), (j, p_j)):
        sigma = view.noise.depth_sigma(points[:, 2])
        C = covariances(points, view.observed.focal_px, CLICK_SIGMA_PX, sigma)
        total += float(np.median(np.trace(C, axis1=1, axis2=2)))
    return 3.0 * float(np.sqrt(total))


def _covariance(refined: Refinement) -> Floats | None:
    values = np.linalg.eigvalsh(refined.information)
    if values[0] <= 1e-12 * values[-1]:
        return None
    return np.linalg.inv(refined.information)
