"""Aligning two views: several starts, each refined, the best one judged.

All thresholds follow from the noise, the resolution and the median depth; the scene's size never
matters.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pose_server.geometry import robust
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.icp import gicp
from pose_server.geometry.matching import NO_MATCHES
from pose_server.geometry.refine import NoiseScale
from pose_server.geometry.se3 import transform
from pose_server.pairs.byproducts import with_byproducts
from pose_server.pairs.judging import PairResult, judged
from pose_server.pairs.pair import Pair
from pose_server.pairs.views import PreparedView

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

_STRONG_INLIERS = 60
_STRONG_SIGMA, _WEAK_SIGMA = 0.003, 0.006  # raw, share of the depth
_ENOUGH_MATCHES = 300  # to find a pose; all are used to judge it
# The image is trusted first. Where depths are worse than stated, a fit that may widen the pixel
# noise settles between both; with loose depths it finds the pixels' pose, and then the noise.
_START_NOISE = NoiseScale(1.0, 4.0)


@dataclass(frozen=True)
class Start:
    """A pose to begin from, and how far it may be off: `sigma` as a share of the median depth (and
    radians).
    """

    kind: str
    T_i_j: Floats
    sigma: float


@dataclass(frozen=True)
class _Candidate:
    start: str
    T_i_j: Floats
    score: float


def align_pair(
    i: PreparedView, j: PreparedView, starts: Sequence[Start] = (), features: bool = True
) -> PairResult:
    """Aligns two views.

    Args:
        i, j: the views.
        starts: poses to begin from, beside the one found by features.
        features: whether to look for a start by features; off where only the given starts may be
            used.
    """
    began = time.perf_counter()
    pair = Pair(i, j)
    matched = time.perf_counter()
    candidates: list[_Candidate] = []
    for start in starts:
        candidates += _from_start(pair, start)
    result = _judge_best(pair, candidates) if candidates else None
    if features and (result is None or not _is_strong(result)):
        more = _from_features(pair)
        candidates += more
        result = _judge_best(pair, candidates) if more else result
    if result is None:
        result = PairResult(None, None, "rejected", (_why_no_start(pair, starts),))
        return with_byproducts(pair, result)
    refined = time.perf_counter()
    if i.dense and j.dense and _needs_icp(result):
        best = _best(candidates)
        dense = _with_icp(pair, best)
        result = result if dense is best else judged(pair, dense.T_i_j, dense.start)
    timings = {
        "match": 1e3 * (matched - began),
        "refine_and_judge": 1e3 * (refined - matched),
        "icp": 1e3 * (time.perf_counter() - refined),
    }
    return with_byproducts(pair, replace(result, timings_ms=timings))


def _needs_icp(result: PairResult) -> bool:
    """Whether the pose is about right, but the features leave it weak."""
    e = result.evidence
    if e is None or result.verdict == "rejected":
        return False
    return result.verdict != "verified" or e.position_sigma > _WEAK_SIGMA


def _judge_best(pair: Pair, candidates: Sequence[_Candidate]) -> PairResult:
    best = _best(candidates)
    return judged(pair, best.T_i_j, best.start)


def _best(candidates: Sequence[_Candidate]) -> _Candidate:
    return max(candidates, key=lambda candidate: candidate.score)


def _is_strong(result: PairResult) -> bool:
    """Whether features alone are beyond what ICP could improve."""
    e = result.evidence
    return (
        e is not None
        and result.verdict == "verified"
        and e.inliers >= _STRONG_INLIERS
        and e.position_sigma < _STRONG_SIGMA
    )


def _why_no_start(pair: Pair, starts: Sequence[Start]) -> str:
    tried = ", ".join(start.kind for start in starts)
    return f"no start: {len(pair.ratio)} feature matches, no five agree" + (
        f"; tried {tried}" if tried else ""
    )


def _from_features(pair: Pair) -> list[_Candidate]:
    if len(pair.ratio) < 6:
        return []
    p_i, p_j = pair.points(pair.ratio)
    bound = float(np.clip(1.5 * pair.sigma, 0.01, 0.03))
    found = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, bound)
    if found is None:
        return []
    T, agrees = found
    T = T.copy()
    T[:3, 3] *= pair.depth_m
    matches = pair.ratio[agrees]
    try:
        first = pair.refined(T, matches, _START_NOISE)
        p_i, p_j = pair.points(pair.ratio)
        near = np.linalg.norm(transform(first.T_i_j, p_j) - p_i, axis=1) < 0.05 * pair.depth_m
        if near.sum() >= 6:
            matches = pair.ratio[near]
            first = pair.refined(first.T_i_j, matches, first.noise)
    except DegenerateGeometryError:
        return []
    candidates = [_candidate(pair, "features", first.T_i_j)]
    return candidates + _guided(pair, "features", first.T_i_j, (0.01, 0.006), matches, first.noise)


def _from_start(pair: Pair, start: Start) -> list[_Candidate]:
    """A given pose, and what guided matching makes of it with a radius that follows its
    uncertainty.
    """
    candidates = [_candidate(pair, start.kind, start.T_i_j)]
    radii = (min(0.06, 2 * start.sigma), 0.008)
    return candidates + _guided(pair, start.kind, start.T_i_j, radii, NO_MATCHES, _START_NOISE)


def _guided(
    pair: Pair, kind: str, T: Floats, radii: tuple[float, ...], kept: Indices, noise: NoiseScale
) -> list[_Candidate]:
    for radius in radii:
        matches = np.unique(np.concatenate((pair.guided(T, radius), kept)), axis=0)
        if len(matches) < 6:
            return []
        some = matches[:: 1 + len(matches) // _ENOUGH_MATCHES]
        try:
            found = pair.refined(T, some, noise)
        except DegenerateGeometryError:
            return []
        T, noise = found.T_i_j, found.noise
    return [_candidate(pair, kind, T)]


def _with_icp(pair: Pair, best: _Candidate) -> _Candidate:
    """ICP as one more candidate; kept only if it scores better."""
    radius = 0.015 * pair.depth_m
    T = gicp(pair.i.cloud, pair.j.cloud, best.T_i_j, (radius, 0.5 * radius))
    other = _candidate(pair, best.start, T)
    return other if other.score > best.score else best


def _candidate(pair: Pair, kind: str, T: Floats) -> _Candidate:
    return _Candidate(kind, T, pair.score(T))
