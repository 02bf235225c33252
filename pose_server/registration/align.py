"""Aligning two views: several starts, each refined, the best one evaluate_pose.

All thresholds follow from the noise, the resolution and the median depth; the scene's size never
matters.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.registration.diagnostics import with_byproducts, with_suggestions
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import (
    Candidate,
    Start,
    best_of,
    from_poses,
    from_start,
    from_surfaces,
    medoid,
    with_icp,
    with_surfaces,
)
from fleetpose.pose_server.registration.surfaces import align_surfaces
from fleetpose.pose_server.registration.verdict.evaluate import PairResult, contested, evaluate_pose
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class AlignSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    usual_poses: int = 2  # poses found by features that are refined
    wide_poses: int = 4  # the same by affine keypoints
    # matches from which on a start of the robot's own needs no features beside it
    strong_inliers: int = 60
    strong_sigma: float = 0.0055  # position sigma up to which that is so, share of the depth
    # position sigma from which on features leave a pose weak, and ICP is tried, share of the depth
    weak_sigma: float = 0.011
    settled_inliers: int = 25  # matches from which on affine keypoints add nothing
    settled_sigma: float = 0.0127  # position sigma up to which that is so, share of the depth


ALIGN = in_use("align", AlignSettings())

_TRUST = {"verified": 3, "plausible": 2, "ambiguous": 1, "rejected": 0}  # an order


def align_pair(
    i: PreparedView,
    j: PreparedView,
    starts: Sequence[Start] = (),
    features: bool = True,
    icp: IcpMethod = "gicp",
) -> PairResult:
    """Aligns two views.

    Args:
        i, j: the views.
        starts: poses to begin from, beside the one found by features.
        features: whether to look for a start by features; off where only the given starts may be
            used.
        icp: how clouds are brought together.
    """
    began = time.perf_counter()
    pair = Pair(i, j, PAIR.ratio)
    if not pair.looks:
        return align_surfaces(pair, starts, features, icp)
    matched = time.perf_counter()
    candidates: list[Candidate] = []
    for start in starts:
        candidates += from_start(pair, start)
    result = _judge_best(pair, candidates, icp) if candidates else None
    if features and (result is None or not _is_strong(result)):
        more = from_poses(pair, pair.ratio, "features", ALIGN.usual_poses)
        candidates += more
        result = _judge_best(pair, candidates, icp) if more else result
    if result is None:
        result = PairResult(None, None, "rejected", (_why_no_start(pair, starts),))
        return with_byproducts(pair, result)
    refined = time.perf_counter()
    result = contested(pair, _finished(pair, candidates, result, icp))
    timings = {
        "match": 1e3 * (matched - began),
        "refine_and_judge": 1e3 * (refined - matched),
        "icp": 1e3 * (time.perf_counter() - refined),
    }
    return with_byproducts(pair, replace(result, timings_ms=timings))


def align_wide(
    i: PreparedView,
    j: PreparedView,
    usual: PairResult,
    starts: Sequence[Start] = (),
    icp: IcpMethod = "gicp",
) -> PairResult:
    """Aligns two views again by their wide sets of salient points; where no matches agree, by the
    shapes of dense clouds.

    Args:
        i, j: the views with their wide sets.
        usual: what `align_pair` made of the usual sets; its pose is a candidate too.
        starts: poses to begin from as well.
        icp: how clouds are brought together.
    """
    began = time.perf_counter()
    pair = Pair(i, j, PAIR.wide_ratio)
    candidates = [one for start in starts for one in from_start(pair, start)]
    candidates += from_poses(pair, pair.ratio, "wide", ALIGN.wide_poses)
    if usual.T_i_j is not None:
        candidates.append(Candidate(pair, usual.start, usual.T_i_j))
    result = _judge_best(pair, candidates, icp) if candidates else usual
    if result.verdict == "rejected" and i.dense and j.dense and icp != "off":
        candidates += from_surfaces(pair)
        result = _judge_best(pair, candidates, icp) if candidates else usual
    result = contested(pair, _finished(pair, candidates, result, icp))
    timings = {**usual.timings_ms, "wide": 1e3 * (time.perf_counter() - began)}
    result = replace(result, timings_ms=timings, depths=usual.depths, moving=usual.moving)
    return with_suggestions(pair, result)


def align_from(
    i: PreparedView,
    j: PreparedView,
    starts: Sequence[Start],
    known: PairResult,
    icp: IcpMethod = "gicp",
) -> PairResult:
    """Aligns two views from given starts alone: what features say of them is known already, and is
    kept where no start leads to anything better. Somebody waits for it: the usual sets must do.

    Args:
        i, j: the views.
        starts: poses to begin from.
        known: what `align_pair` or `align_wide` made of the same views.
        icp: how clouds are brought together.
    """
    began = time.perf_counter()
    pair = Pair(i, j, PAIR.ratio)
    if not pair.looks:
        found = align_surfaces(pair, starts, False, icp)
        return known if _TRUST[found.verdict] < _TRUST[known.verdict] else found
    candidates = [one for start in starts for one in from_start(pair, start)]
    if known.T_i_j is not None:
        candidates.append(Candidate(pair, known.start, known.T_i_j))
    if not candidates or best_of(candidates).T_i_j is known.T_i_j:
        return known
    result = contested(pair, _finished(pair, candidates, _judge_best(pair, candidates, icp), icp))
    if _TRUST[result.verdict] < _TRUST[known.verdict]:
        return known
    timings = {"from_starts": 1e3 * (time.perf_counter() - began)}
    return replace(result, timings_ms=timings, depths=known.depths, moving=known.moving)


def is_settled(result: PairResult) -> bool:
    """Whether the wide sets of salient points could not add to a result."""
    if result.mirrored or result.surfaces is not None:
        return True
    e = result.evidence
    return (
        e is not None
        and result.verdict == "verified"
        and e.inliers >= ALIGN.settled_inliers
        and e.position_sigma < ALIGN.settled_sigma
    )


def _finished(
    pair: Pair, candidates: Sequence[Candidate], result: PairResult, icp: IcpMethod
) -> PairResult:
    """The result of the best candidate, or of what ICP makes of it where that is better."""
    if result.verdict == "rejected" or not (result.icp is None or _needs_icp(result)):
        return result
    best = best_of(candidates)
    refined = with_icp(pair, best, icp)
    if refined.icp is not None and refined.icp.kept:
        again = evaluate_pose(pair, refined.T_i_j, refined.start)
        return replace(again, icp=refined.icp)
    return replace(result, icp=result.icp or refined.icp)


def _needs_icp(result: PairResult) -> bool:
    """Whether the pose is about right, but the features leave it weak."""
    e = result.evidence
    return e is not None and (result.verdict != "verified" or e.position_sigma > ALIGN.weak_sigma)


def _judge_best(pair: Pair, candidates: Sequence[Candidate], icp: IcpMethod) -> PairResult:
    best = medoid(pair, candidates)
    if icp == "gicp":
        best = with_surfaces(pair, best)
    result = evaluate_pose(pair, best.T_i_j, best.start, best.T_by_matches)
    return replace(result, icp=best.icp)


def _is_strong(result: PairResult) -> bool:
    """Whether features alone are beyond what ICP could improve."""
    e = result.evidence
    return (
        e is not None
        and result.verdict == "verified"
        and e.inliers >= ALIGN.strong_inliers
        and e.position_sigma < ALIGN.strong_sigma
    )


def _why_no_start(pair: Pair, starts: Sequence[Start]) -> str:
    tried = ", ".join(start.kind for start in starts)
    return f"no start: {len(pair.ratio)} feature matches, no five agree" + (
        f"; tried {tried}" if tried else ""
    )
