"""What a found pose is worth: all evidence at the pose, its covariance, its errors, the verdict."""

from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.depth_comparison import DepthErrors
from fleetpose.pose_server.calibration.depth_shift import DepthShift
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.free_space import Agreement
from fleetpose.pose_server.geometry.features.matching import union
from fleetpose.pose_server.geometry.features.motion import Mask
from fleetpose.pose_server.geometry.features.refine import NoiseScale, Refinement
from fleetpose.pose_server.geometry.se3 import (
    inverse,
    position_covariance,
    rotation_angle,
    transform,
)
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.pair_icp import IcpReport
from fleetpose.pose_server.registration.verdict.evidence import NO_RIVAL, Evidence, SurfaceEvidence
from fleetpose.pose_server.registration.verdict.explained import count_places, explained
from fleetpose.pose_server.registration.verdict.fitted_model import MODEL
from fleetpose.pose_server.registration.verdict.grave_probability import (
    GRAVE_PROBABILITY,
    holes_beyond_few,
    p_grave,
    stands,
    with_rivals,
)
from fleetpose.pose_server.registration.verdict.hearing import ByClicks, Hearing
from fleetpose.pose_server.registration.verdict.rivals import (
    left_over,
    one_step_on,
    rivals_of,
    unique_points,
)
from fleetpose.pose_server.registration.verdict.words import ELSEWHERE, Verdict, judge
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class EvaluateSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    # Matches share depth errors, so that the raw covariance is too sure: inflated, with a floor,
    # it is right on the average of the recordings at hand (variance factor; radians and shares of
    # the median depth)
    covariance_inflation: float = 2.8
    covariance_floor: float = 0.0003  # least sigma of a pose, radians and shares of the depth
    judged_radius: float = 0.008  # around predicted places, share of the depth
    telling_holes: float = 0.03  # beyond what right poses have
    most_pixel_noise: float = 4.0  # that may be found at a pose: an alias shows by it


EVALUATE = in_use("evaluate", EvaluateSettings())


@dataclass(frozen=True, eq=False)
class PairResult:
    """An alignment and how good it is. Poses are camera j in camera i, covariances left, rotation
    first. `depths` tells how the depths of both views fit each other, whatever the verdict; of two
    views of one robot `moving` tells what moves, and `shift` where j's depths fit its image best;
    `suggested` (M, 4) pixels of both views, u_i v_i u_j v_j, that an operator might confirm, best
    first; only where it is not verified. `confirmed` by clicks: they determine a pose, and all that
    agree with each other agree with this one; `grown` from them: they are in it. `p_grave` is the
    probability that the pose is gravely off, 1 where there is none; `evidence` is what speaks for
    it by images, `surfaces` where one has none; `rivals` are other (4, 4) poses that these support
    as well. `mirrored`: the views fit only if one of them is mirrored.
    `structure` is what of the world its matches rest on, in the frame of view i; `hearing` what
    became of the clicks it was made with, `by_clicks` the pose that these give by themselves, `icp`
    what ICP did or would have done. `twofold`: it would be verified, but another pose looks right
    as well, or all is right but for things that stand about in both views and are not found;
    `singled_out`: others looked right, but saw less of what is there.
    """

    T_i_j: Floats | None
    covariance: Floats | None
    verdict: Verdict
    reasons: tuple[str, ...]
    inliers: int = 0
    overlap: float = 0.0
    rmse_m: float = 0.0
    regression_error_m2: float = 0.0
    regression_count: int = 0
    start: str = "none"
    evidence: Evidence | None = None
    surfaces: SurfaceEvidence | None = None
    timings_ms: dict[str, float] = field(default_factory=dict)
    depths: DepthErrors | None = None
    moving: tuple[Mask | None, Mask | None] = (None, None)
    suggested: Floats | None = None
    shift: DepthShift | None = None
    confirmed: bool = False
    grown: bool = False
    p_grave: float = 1.0
    rivals: tuple[Floats, ...] = ()
    mirrored: bool = False
    twofold: bool = False
    singled_out: bool = False
    structure: Structure | None = None
    hearing: Hearing | None = None
    by_clicks: ByClicks | None = None
    icp: IcpReport | None = None


def evaluate_pose(
    pair: Pair, T: Floats, start: str, T_by_matches: Floats | None = None
) -> PairResult:
    """Collects all evidence for a pose, and the verdict.

    Args:
        pair: the views.
        T: the final pose: surfaces are compared at it.
        start: what led to it.
        T_by_matches: the pose by matches alone, where surfaces have moved it since: matches are
            compared at it.
    """
    seen = pair.agreement(T)
    try:
        evidence, covariance, agreeing = _collected(pair, T, T_by_matches, seen)
    except DegenerateGeometryError as error:
        return PairResult(T, None, "rejected", (str(error),), overlap=seen.overlap, start=start)
    chance = p_grave(evidence, MODEL)
    verdict, reasons = judge(evidence, chance)
    error_m2, count = regression_error(pair, T)
    return PairResult(
        T_i_j=T,
        covariance=covariance,
        verdict=verdict,
        reasons=reasons,
        inliers=evidence.inliers,
        overlap=seen.overlap,
        rmse_m=float(np.sqrt(error_m2 / count)) if count else 0.0,
        regression_error_m2=error_m2,
        regression_count=count,
        start=start,
        evidence=evidence,
        p_grave=chance,
        structure=Structure.of(pair.i.observed.points[agreeing[:, 0]]),
    )


def contested(pair: Pair, result: PairResult) -> PairResult:
    """A result beside the rivals that the place's repetitions offer. A robot follows itself in
    small steps: there none is as near.
    """
    e, T = result.evidence, result.T_i_j
    if e is None or T is None or pair.i.name.robot == pair.j.name.robot:
        return result
    result = replace(result, twofold=_but_for_holes(result.verdict, e))
    if result.verdict not in ("verified", "plausible"):
        return result
    exact = pair.exact(T, union(pair.guided(T, EVALUATE.judged_radius), pair.ratio))
    rivals = [
        rival
        for rival in rivals_of(pair, T, exact)
        if rival.by_itself or _own_chance(pair, rival.T_i_j) < GRAVE_PROBABILITY.rival_p_grave
    ]
    unique = unique_points(pair, exact)
    if not rivals and unique is None:
        return result
    e = replace(e, lead=min((rival.lead for rival in rivals), default=NO_RIVAL))
    chance = with_rivals(result.p_grave, [rival.lead for rival in rivals])
    verdict, reasons = judge(e, result.p_grave)
    others = [rival.T_i_j for rival in rivals if stands(rival.lead)]
    if verdict != "ambiguous" and unique == 0:
        verdict, reasons = "ambiguous", (ELSEWHERE,)
        others = one_step_on(pair, T)
        chance = max(chance, GRAVE_PROBABILITY.elsewhere_p_grave)
    return replace(
        result,
        evidence=e,
        verdict=verdict,
        reasons=reasons,
        p_grave=chance,
        twofold=result.twofold or (result.verdict == "verified" and verdict != "verified"),
        singled_out=verdict == "verified",
        rivals=tuple(others),
    )


def _but_for_holes(verdict: Verdict, e: Evidence) -> bool:
    """Whether a pose would rather be right than wrong if all that stands about were found: of two
    wings that are alike but for what hangs on their walls one was taken for the other. It is said
    of right pairs too, now and then.
    """
    if verdict == "verified" or holes_beyond_few(e) < EVALUATE.telling_holes:
        return False
    filled = replace(e, explained=replace(e.explained, holes=0.0))
    return p_grave(filled, MODEL) < GRAVE_PROBABILITY.elsewhere_p_grave


def _own_chance(pair: Pair, T: Floats) -> float:
    """How likely a pose is gravely off by its own evidence, whatever else is possible."""
    try:
        return p_grave(_collected(pair, T, None, pair.agreement(T))[0], MODEL)
    except DegenerateGeometryError:
        return 1.0


def _collected(
    pair: Pair, T: Floats, T_by_matches: Floats | None, seen: Agreement
) -> tuple[Evidence, Floats, Indices]:
    """All evidence for a pose, its covariance (6, 6), and the matches (M, 2) that agree with it.

    Raises:
        DegenerateGeometryError: the matches do not determine a pose.
    """
    rest = T if T_by_matches is None else T_by_matches
    matches = union(pair.guided(rest, EVALUATE.judged_radius), pair.ratio)
    if len(matches) < 6:
        raise DegenerateGeometryError(f"{len(matches)} matches at the found pose, need 6")
    again = pair.refined(rest, matches, NoiseScale(), 4, EVALUATE.most_pixel_noise)
    final = pair.scored(rest, matches, again.noise)
    # copies of one spot in several tilted images tell one thing, not several
    places = _places(pair, matches[final.inliers])
    information = final.information * (places / max(int(final.inliers.sum()), 1))
    covariance = calibrated(information, pair.depth_m)
    if covariance is None:
        raise DegenerateGeometryError("the matches do not determine a pose")
    evidence = _evidence(pair, T, matches, final, again, covariance, places, seen)
    return evidence, covariance, matches[final.inliers]


def _evidence(
    pair: Pair,
    T: Floats,
    matches: Indices,
    final: Refinement,
    again: Refinement,
    covariance: Floats,
    places: int,
    seen: Agreement,
) -> Evidence:
    rest = final.T_i_j
    ratio = pair.scored(rest, pair.ratio, again.noise) if len(pair.ratio) >= 3 else None
    unguided = ratio.inliers if ratio else np.zeros(len(pair.ratio), bool)
    consistent = _places(pair, pair.ratio[unguided])
    inliers = final.inliers
    exact = inliers & (np.abs(final.across_px) < PAIR.exact_sigmas * pair.pixel_px)
    rival, rivalled = _rival(pair, rest, ratio, again.noise)
    found_again = explained(pair, rest, matches[exact], unguided)
    return Evidence(
        inliers=places,
        exact=_places(pair, matches[exact]),
        ratio_inliers=consistent,
        ratio_matches=len(pair.ratio),
        rival=rival,
        rivalled=rivalled,
        position_sigma=_weakest(position_covariance(T, covariance)) / pair.depth_m,
        rotation_sigma_rad=_weakest(covariance[:3, :3]),
        across_px=_robust_sigma(final.across_px[inliers]),
        pixel_sigma_px=pair.pixel_px,
        shift=pair.apart(rest, again.T_i_j)[0],
        turn_rad=rotation_angle(again.T_i_j[:3, :3].T @ rest[:3, :3]),
        pulled=pair.apart(rest, T)[0],
        compared=seen.compared,
        agree=seen.agree,
        through=seen.through,
        spread=_spread(pair, matches[inliers]),
        depth_noise=again.noise.depth,
        depth_sigma=pair.sigma,
        lead=NO_RIVAL,
        explained=found_again,
    )


def _weakest(covariance: Floats) -> float:
    """Sigma of the weakest direction of a covariance (3, 3)."""
    return float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))


def _robust_sigma(residuals: Floats) -> float:
    return 1.4826 * float(np.median(residuals)) if len(residuals) else float("inf")


def _places(pair: Pair, matches: Indices) -> int:
    """Matches at distinct places in both views: copies of one spot count once."""
    uv_i, uv_j = pair.i.observed.uv[matches[:, 0]], pair.j.observed.uv[matches[:, 1]]
    return min(count_places(uv_i), count_places(uv_j))


def _spread(pair: Pair, matches: Indices) -> float:
    """The smaller extent of the matches in the images, as a share of the image height."""
    shares = []
    for view, column in ((pair.i.observed, 0), (pair.j.observed, 1)):
        uv = view.uv[matches[:, column]]
        extent = np.sqrt(max(np.linalg.eigvalsh(np.cov(uv.T))[0], 0.0)) if len(uv) > 3 else 0.0
        shares.append(float(extent) / view.size[1])
    return min(shares)


def _rival(pair: Pair, T: Floats, ratio: Refinement | None, noise: NoiseScale) -> tuple[int, int]:
    """Support of the best other pose, searched among the matches that the winner leaves over, and
    the winner's: each without the matches that agree with both.
    """
    if ratio is None:
        return 0, 0
    own = ratio.inliers
    nobody = 0, _places(pair, pair.ratio[own])
    other = left_over(pair, own, noise)
    if other is None or not pair.gravely_apart(T, other):
        return nobody
    theirs = pair.scored(other, pair.ratio, noise).inliers
    return _places(pair, pair.ratio[theirs & ~own]), _places(pair, pair.ratio[own & ~theirs])


def calibrated(
    information: Floats,
    depth_m: float,
    inflation: float | None = None,
    floor: float | None = None,
) -> Floats | None:
    """(6, 6) covariance with the inflation and the floor that make it honest, those of matches
    unless told; None if it is not determined.
    """
    inflation = EVALUATE.covariance_inflation if inflation is None else inflation
    floor = EVALUATE.covariance_floor if floor is None else floor
    scale = np.diag([1.0] * 3 + [1.0 / depth_m] * 3)  # positions as shares of the depth
    scaled = np.linalg.inv(scale) @ information @ np.linalg.inv(scale)
    values, vectors = np.linalg.eigh(scaled)
    if not np.isfinite(values).all() or values[0] <= 1e-9 * values[-1]:
        return None
    covariance = inflation * (vectors / values) @ vectors.T + floor**2 * np.eye(6)
    back = np.linalg.inv(scale)
    return back @ covariance @ back


def regression_error(pair: Pair, T: Floats) -> tuple[float, int]:
    """Sum of truncated squared distances (m^2) over salient points of both views brought into each
    other's sight.
    """
    total, count = 0.0, 0
    radius = max(0.03, 4 * pair.sigma) * pair.depth_m
    for source, target, T_ts in ((pair.j, pair.i, T), (pair.i, pair.j, inverse(T))):
        predicted = source.observed.predict_in(target.observed, T_ts, 0.0)
        if len(predicted.index) == 0:
            continue
        moved = transform(T_ts, source.observed.points[predicted.index])
        distance, _ = target.point_tree.query(moved, distance_upper_bound=radius)
        distance = np.minimum(distance, radius)
        total += float((distance**2).sum())
        count += len(distance)
    return total, count
