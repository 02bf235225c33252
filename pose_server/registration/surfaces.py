"""Two views of which one has no image: aligned and judged by the shape of their clouds alone.

Matches by shape make poses, a rough ICP improves each, and the pose at which the surfaces agree
best is refined. What is seen through, what does not agree, how little overlaps and what other pose
does nearly as well tell how likely it is gravely off.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features import robust
from fleetpose.pose_server.geometry.features.matching import ratio_matches
from fleetpose.pose_server.geometry.features.triangles import poses_by_triangles
from fleetpose.pose_server.geometry.icp import SurfaceFit, by_open3d, gicp, residual
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.geometry.se3 import position_covariance
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.pair_icp import IcpReport
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import (
    PairResult,
    calibrated,
    regression_error,
)
from fleetpose.pose_server.registration.verdict.evidence import SurfaceEvidence
from fleetpose.pose_server.registration.verdict.grave_probability import GRAVE_PROBABILITY
from fleetpose.pose_server.registration.verdict.words import Verdict
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]

_TOO_FEW = "too few points to be aligned by their shape, and no image: clicks can"


@dataclass(frozen=True)
class SurfacesSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    shape_sigma: float = 0.01  # of where a shape is, share of its depth
    noise_bound: float = 0.03  # of a solver that forgives what is wrong alike, share of the depth
    rough_radius: float = 0.08  # reach of ICP from a coarse pose, share of the depth
    rough_iterations: int = 10  # of it
    fine_radius: float = 0.04  # reach of ICP after that, share of the depth
    fine_iterations: int = 20  # of it
    looked_at: int = 3  # of the poses after the rough ICP
    least_sigma: float = 0.001  # of a surface, share of the depth: no sensor is better
    # of a covariance by surfaces: neighbouring points share their errors; set on
    # rgbd_7scenes_redkitchen_A
    inflation: float = 3.0
    # what a sensor gets wrong alike everywhere, radians and shares of the depth; set there too
    floor: float = 0.01
    # log odds of a grave error of nothing; set by hand on rgbd_7scenes_redkitchen_A
    bias: float = 3.0
    per_score: float = -20.0  # log odds per unit of the surfaces' score; set there too
    per_rival: float = 12.0  # log odds per share that a rival has; set there too
    plain: float = 0.5  # score at which a robot that follows itself in small steps looks no further
    most_through: float = 0.25  # as in the verdict by images
    as_good: float = 0.6  # of the winner's score: a pose elsewhere that has it may be the right one


SURFACES = in_use("surfaces", SurfacesSettings())


def align_surfaces(
    pair: Pair, starts: Sequence[Start], search: bool, icp: IcpMethod = "gicp"
) -> PairResult:
    """Aligns two views by their clouds.

    Args:
        pair: the views.
        starts: poses to begin from.
        search: whether to look for poses by shape as well.
        icp: how clouds are brought together in the end; searching takes GICP.
    """
    began = time.perf_counter()
    if not (pair.i.shaped and pair.j.shaped):
        return PairResult(None, None, "rejected", (_TOO_FEW,))
    rough = [_roughly(pair, start.kind, start.T_i_j) for start in starts]
    if search:
        rough.append(_roughly(pair, "identity", np.eye(4)))
    own = pair.i.name.robot == pair.j.name.robot
    if search and not (own and max(one.score for one in rough) > SURFACES.plain):
        rough += [_roughly(pair, "shape", T) for T in _by_shape(pair)]
    if not rough:
        return PairResult(None, None, "rejected", ("no start, and nothing may be searched",))
    rough.sort(key=lambda one: -one.score)
    best = max(
        (_finely(pair, one) for one in rough[: SURFACES.looked_at]), key=lambda one: one.score
    )
    rival = max((o.score for o in rough if pair.gravely_apart(o.T_i_j, best.T_i_j)), default=0.0)
    began_icp = time.perf_counter()
    best, report = _with_method(pair, best, icp, began_icp)
    result = replace(_judged(pair, best, max(rival, 0.0)), icp=report)
    return replace(result, timings_ms={"surfaces": 1e3 * (time.perf_counter() - began)})


@dataclass(frozen=True, eq=False)
class _Found:
    """A pose, what led to it, how well the surfaces agree there, and how they determine it."""

    kind: str
    T_i_j: Floats
    score: float
    fit: SurfaceFit | None = None
    ms: float = 0.0


def score(pair: Pair, T_i_j: Floats) -> float:
    """How well surfaces agree at a pose, about -1 to 1."""
    seen = pair.agreement(T_i_j)
    return (seen.mean_agree - seen.through) * seen.overlap**0.5


def _by_shape(pair: Pair) -> list[Floats]:
    """Coarse poses on which matches by shape agree."""
    shapes_i, shapes_j = (view.measured.shapes(pair.depth_m) for view in (pair.i, pair.j))
    alike, _ = ratio_matches(shapes_i.descriptors, shapes_j.descriptors, 1.0)
    if len(alike) < 3:
        return []
    empty = [len(view.observed.uv) for view in (pair.i, pair.j)]
    i, j = (
        view.observed.with_points(shapes.points, SURFACES.shape_sigma)
        for view, shapes in ((pair.i, shapes_i), (pair.j, shapes_j))
    )
    poses = [T for T, _ in poses_by_triangles(i, j, alike + empty, pair.depth_m)]
    p_i, p_j = shapes_i.points[alike[:, 0]], shapes_j.points[alike[:, 1]]
    solved = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, SURFACES.noise_bound)
    if solved is not None:
        T = solved[0].copy()
        T[:3, 3] *= pair.depth_m
        poses.append(T)
    return poses


def _roughly(pair: Pair, kind: str, T_i_j: Floats) -> _Found:
    i, j = (view.measured.for_rough_icp for view in (pair.i, pair.j))
    T = gicp(i, j, T_i_j, SURFACES.rough_radius * pair.depth_m, SURFACES.rough_iterations).T_i_j
    return _Found(kind, T, score(pair, T))


def _finely(pair: Pair, one: _Found) -> _Found:
    i, j = (view.measured.for_icp for view in (pair.i, pair.j))
    began = time.perf_counter()
    fit = gicp(i, j, one.T_i_j, SURFACES.fine_radius * pair.depth_m, SURFACES.fine_iterations)
    ms = 1e3 * (time.perf_counter() - began)
    return _Found(one.kind, fit.T_i_j, score(pair, fit.T_i_j), fit, ms)


def _with_method(
    pair: Pair, one: _Found, method: IcpMethod, began: float
) -> tuple[_Found, IcpReport]:
    """The pose after the ICP that was asked for, where that is no worse, and what is told of it."""
    i, j = (view.measured.for_icp.cloud.points()[:, :3] for view in (pair.i, pair.j))
    radius_m = SURFACES.fine_radius * pair.depth_m
    T, name, kept = one.T_i_j, "gicp", True
    if method in ("point_to_point", "point_to_plane"):
        T, name = by_open3d(i, j, one.T_i_j, radius_m, method), method
        kept = score(pair, T) > one.score
    left = residual(pair.i.measured.for_icp, j, T, radius_m)
    ms = 1e3 * (time.perf_counter() - began) + (one.ms if name == "gicp" else 0.0)
    report = IcpReport(name, left.error_m2, left.rms_m, left.count, ms, kept)
    return (replace(one, T_i_j=T, score=score(pair, T)) if kept else one), report


def _judged(pair: Pair, one: _Found, rival: float) -> PairResult:
    """The verdict on a pose by clouds alone."""
    seen = pair.agreement(one.T_i_j)
    covariance = _covariance(pair, one)
    if covariance is None:
        reasons = ("the surfaces do not determine a pose",)
        return PairResult(one.T_i_j, None, "rejected", reasons, overlap=seen.overlap)
    weakest = [np.linalg.eigvalsh(C)[-1] ** 0.5 for C in
               (position_covariance(one.T_i_j, covariance), covariance[:3, :3])]  # fmt: skip
    evidence = SurfaceEvidence(
        compared=seen.compared,
        agree=seen.agree,
        through=seen.through,
        overlap=seen.overlap,
        score=one.score,
        rival=rival,
        position_sigma=float(weakest[0]) / pair.depth_m,
        rotation_sigma_rad=float(weakest[1]),
    )
    chance = p_grave(evidence)
    verdict, reasons = _verdict(evidence, chance)
    error_m2, count = regression_error(pair, one.T_i_j)
    return PairResult(
        T_i_j=one.T_i_j,
        covariance=covariance,
        verdict=verdict,
        reasons=reasons,
        overlap=seen.overlap,
        rmse_m=float(np.sqrt(error_m2 / count)) if count else 0.0,
        regression_error_m2=error_m2,
        regression_count=count,
        start=one.kind,
        surfaces=evidence,
        p_grave=chance,
    )


def p_grave(e: SurfaceEvidence) -> float:
    """Probability (0..1) that a pose with this evidence is gravely off."""
    share = e.rival / max(e.score, 1e-3)
    log_odds = (
        SURFACES.bias
        + SURFACES.per_score * e.score
        + SURFACES.per_rival * max(share - SURFACES.as_good / 2, 0.0)
    )
    return float(1 / (1 + np.exp(-np.clip(log_odds, -6.0, 6.0))))


def _verdict(e: SurfaceEvidence, chance: float) -> tuple[Verdict, tuple[str, ...]]:
    told = (
        f"{e.agree:.0%} of {e.compared} surface points agree, {e.through:.0%} are seen through, "
        f"{e.overlap:.0%} overlap"
    )
    if chance > GRAVE_PROBABILITY.rejected_p_grave or e.through > SURFACES.most_through:
        return "rejected", (told,)
    if e.rival > SURFACES.as_good * e.score:
        return "ambiguous", (f"{told}; a pose elsewhere does {e.rival / e.score:.0%} as well",)
    off = 3 * e.position_sigma
    if chance > GRAVE_PROBABILITY.verified_p_grave:
        return "plausible", (f"gravely off with a probability of {chance:.1%}: {told}",)
    if off > PAIR.grave_position or 3 * e.rotation_sigma_rad > PAIR.grave_rotation_rad:
        return "plausible", (f"three sigma of the position are {off:.1%} of the depth: {told}",)
    return "verified", (told,)


def _covariance(pair: Pair, one: _Found) -> Floats | None:
    """(6, 6) of T_i_j by how the surfaces determine it; none where they let it slide."""
    assert one.fit is not None
    noise_m = max(pair.sigma, SURFACES.least_sigma) * pair.depth_m
    return calibrated(
        one.fit.hessian / noise_m**2, pair.depth_m, SURFACES.inflation, SURFACES.floor
    )
