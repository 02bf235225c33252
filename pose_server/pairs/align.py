"""Aligning two views: several starts, each refined, the best one judged.

All thresholds follow from the noise, the resolution and the median depth; the scene's size never
matters.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from pose_server.geometry import robust
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.evidence import Agreement, agreement
from pose_server.geometry.icp import gicp
from pose_server.geometry.matching import (
    NO_MATCHES,
    guided_matches,
    one_to_one,
    ratio_matches,
    similarities,
)
from pose_server.geometry.refine import NoiseScale, Refinement, refine
from pose_server.geometry.se3 import inverse, position_covariance, rotation_angle, transform
from pose_server.pairs.verdict import Evidence, Verdict, judge
from pose_server.pairs.views import PreparedView

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

RATIO = 0.9
# Matches share depth errors, so that the raw covariance is too sure: inflated, with a floor, it
# was calibrated on one data set and checked on others (variance factor; radians and shares of the
# median depth).
COVARIANCE_INFLATION = 4.0
COVARIANCE_FLOOR = 3e-4
_STRONG_INLIERS = 60
_STRONG_SIGMA, _WEAK_SIGMA = 0.003, 0.006  # raw, share of the depth
_ENOUGH_MATCHES = 300  # to find a pose; all are used to judge it
_START_NOISE = NoiseScale(2.0, 1.5)
_COMMON_NOISE = NoiseScale(1.5, 1.2)  # candidates are compared at the same noise


@dataclass(frozen=True)
class Start:
    """A pose to begin from, and how far it may be off: `sigma` as a share of the median depth (and
    radians).
    """

    kind: str
    T_i_j: Floats
    sigma: float


@dataclass(frozen=True)
class PairResult:
    """An alignment and how good it is. Poses are camera j in camera i, covariances left, rotation
    first.
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
    timings_ms: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Candidate:
    start: str
    T_i_j: Floats
    score: float


class _Pair:
    """What every step of one alignment shares."""

    def __init__(self, i: PreparedView, j: PreparedView) -> None:
        self.i, self.j = i, j
        self.depth_m = 0.5 * (i.median_depth_m + j.median_depth_m)
        self.sigma = float(np.hypot(i.surface.depth_sigma, j.surface.depth_sigma))
        self.cosines = similarities(i.descriptors, j.descriptors)
        lifted_i, lifted_j = i.observed.lifted, j.observed.lifted
        found = ratio_matches(self.cosines[np.ix_(lifted_i, lifted_j)], RATIO)
        self.ratio = np.column_stack((lifted_i[found[:, 0]], lifted_j[found[:, 1]]))

    def points(self, matches: Indices) -> tuple[Floats, Floats]:
        return self.i.observed.points[matches[:, 0]], self.j.observed.points[matches[:, 1]]

    def refined(
        self, T: Floats, matches: Indices, noise: NoiseScale, iterations: int = 6
    ) -> Refinement:
        return refine(self.i.observed, self.j.observed, matches, T, noise, iterations)

    def scored(self, T: Floats, matches: Indices, noise: NoiseScale) -> Refinement:
        return refine(self.i.observed, self.j.observed, matches, T, noise, 0)

    def guided(self, T: Floats, radius: float) -> Indices:
        """Matches around the predicted place, both ways; the radius is a share of the depth."""
        i, j = self.i.observed, self.j.observed
        tolerance = max(0.1, 5 * self.sigma)
        pixels_i, pixels_j = max(radius * i.focal_px, 4.0), max(radius * j.focal_px, 4.0)
        into_j, score_j = guided_matches(
            i.predict_in(j, inverse(T), pixels_j),
            j.tree,
            j.inverse_depth,
            self.cosines,
            pixels_j,
            tolerance,
        )
        into_i, score_i = guided_matches(
            j.predict_in(i, T, pixels_i),
            i.tree,
            i.inverse_depth,
            self.cosines.T,
            pixels_i,
            tolerance,
        )
        both = np.concatenate((into_j, into_i[:, ::-1]))
        return one_to_one(both, np.concatenate((score_j, score_i)))

    def agreement(self, T: Floats) -> Agreement:
        return agreement(self.i.surface, self.j.surface, T)

    def score(self, T: Floats) -> float:
        """Consistent matches times surface agreement, at a noise level that is the same for all
        candidates.
        """
        support = 0.0
        if len(self.ratio) >= 3:
            support = self.scored(T, self.ratio, _COMMON_NOISE).support
        if self.i.dense and self.j.dense:
            support = support**0.5
        seen = self.agreement(T)
        return (support + 1.0) * max(0.02, seen.mean_agree - max(0.0, seen.through - 0.05))


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
    pair = _Pair(i, j)
    matched = time.perf_counter()
    candidates: list[_Candidate] = []
    for start in starts:
        candidates += _from_start(pair, start)
    result = _judged(pair, _best(candidates)) if candidates else None
    if features and (result is None or not _is_strong(result)):
        more = _from_features(pair)
        candidates += more
        result = _judged(pair, _best(candidates)) if more else result
    if result is None:
        return PairResult(None, None, "rejected", (_why_no_start(pair, starts),))
    judged = time.perf_counter()
    if i.dense and j.dense and _needs_icp(result):
        best = _best(candidates)
        dense = _with_icp(pair, best)
        result = result if dense is best else _judged(pair, dense)
    timings = {
        "match": 1e3 * (matched - began),
        "refine_and_judge": 1e3 * (judged - matched),
        "icp": 1e3 * (time.perf_counter() - judged),
    }
    return replace(result, timings_ms=timings)


def _needs_icp(result: PairResult) -> bool:
    """Whether the pose is about right, but the features leave it weak."""
    e = result.evidence
    if e is None or result.verdict == "rejected":
        return False
    return result.verdict != "verified" or e.position_sigma > _WEAK_SIGMA


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


def _why_no_start(pair: _Pair, starts: Sequence[Start]) -> str:
    tried = ", ".join(start.kind for start in starts)
    return f"no start: {len(pair.ratio)} feature matches, no five agree" + (
        f"; tried {tried}" if tried else ""
    )


def _from_features(pair: _Pair) -> list[_Candidate]:
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


def _from_start(pair: _Pair, start: Start) -> list[_Candidate]:
    """A given pose, and what guided matching makes of it with a radius that follows its
    uncertainty.
    """
    candidates = [_candidate(pair, start.kind, start.T_i_j)]
    radii = (min(0.06, 2 * start.sigma), 0.008)
    return candidates + _guided(pair, start.kind, start.T_i_j, radii, NO_MATCHES, _START_NOISE)


def _guided(
    pair: _Pair, kind: str, T: Floats, radii: tuple[float, ...], kept: Indices, noise: NoiseScale
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


def _with_icp(pair: _Pair, best: _Candidate) -> _Candidate:
    """ICP as one more candidate; kept only if it scores better."""
    radius = 0.015 * pair.depth_m
    T = gicp(pair.i.cloud, pair.j.cloud, best.T_i_j, (radius, 0.5 * radius))
    other = _candidate(pair, best.start, T)
    return other if other.score > best.score else best


def _candidate(pair: _Pair, kind: str, T: Floats) -> _Candidate:
    return _Candidate(kind, T, pair.score(T))


def _judged(pair: _Pair, best: _Candidate) -> PairResult:
    """Collects all evidence at the final pose, and the verdict."""
    T = best.T_i_j
    matches = np.unique(np.concatenate((pair.guided(T, 0.008), pair.ratio)), axis=0)
    seen = pair.agreement(T)
    if len(matches) < 6:
        reason = f"{len(matches)} matches at the found pose, need 6"
        return PairResult(T, None, "rejected", (reason,), overlap=seen.overlap, start=best.start)
    try:
        again = pair.refined(T, matches, NoiseScale(), 4)
        final = pair.scored(T, matches, again.noise)
    except DegenerateGeometryError as error:
        return PairResult(
            T, None, "rejected", (str(error),), overlap=seen.overlap, start=best.start
        )
    covariance = _calibrated(final.information, pair.depth_m)
    if covariance is None:
        reason = "the matches do not determine a pose"
        return PairResult(T, None, "rejected", (reason,), overlap=seen.overlap, start=best.start)
    evidence = _evidence(pair, T, matches, final, again, covariance, seen)
    verdict, reasons = judge(evidence)
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
        start=best.start,
        evidence=evidence,
    )


def _evidence(
    pair: _Pair,
    T: Floats,
    matches: Indices,
    final: Refinement,
    again: Refinement,
    covariance: Floats,
    seen: Agreement,
) -> Evidence:
    ratio = pair.scored(T, pair.ratio, again.noise) if len(pair.ratio) >= 3 else None
    consistent = _places(pair, pair.ratio[ratio.inliers]) if ratio else 0
    raw = np.linalg.inv(final.information)
    inliers = final.inliers
    return Evidence(
        inliers=_places(pair, matches[inliers]),
        ratio_inliers=consistent,
        ratio_matches=len(pair.ratio),
        rival=_rival(pair, ratio),
        position_sigma=float(np.sqrt(np.linalg.eigvalsh(position_covariance(T, raw))[-1]))
        / pair.depth_m,
        rotation_sigma_rad=float(np.sqrt(np.linalg.eigvalsh(raw[:3, :3])[-1])),
        across_px=_robust_sigma(final.across_px[inliers]),
        pixel_sigma_px=float(
            np.hypot(pair.i.observed.pixel_sigma_px, pair.j.observed.pixel_sigma_px)
        ),
        shift=float(np.linalg.norm(again.T_i_j[:3, 3] - T[:3, 3])) / pair.depth_m,
        turn_rad=rotation_angle(again.T_i_j[:3, :3].T @ T[:3, :3]),
        compared=seen.compared,
        agree=seen.agree,
        through=seen.through,
        spread=_spread(pair, matches[inliers]),
        depth_noise=again.noise.depth,
    )


def _robust_sigma(residuals: Floats) -> float:
    return 1.4826 * float(np.median(residuals)) if len(residuals) else float("inf")


def _places(pair: _Pair, matches: Indices) -> int:
    """Matches at distinct places, on a grid of 4 px in both views: copies of one spot count
    once.
    """
    if len(matches) == 0:
        return 0
    cells_i = np.unique(np.rint(pair.i.observed.uv[matches[:, 0]] / 4), axis=0)
    cells_j = np.unique(np.rint(pair.j.observed.uv[matches[:, 1]] / 4), axis=0)
    return min(len(cells_i), len(cells_j))


def _spread(pair: _Pair, matches: Indices) -> float:
    """The smaller extent of the matches in the images, as a share of the image height."""
    shares = []
    for view, column in ((pair.i.observed, 0), (pair.j.observed, 1)):
        uv = view.uv[matches[:, column]]
        extent = np.sqrt(max(np.linalg.eigvalsh(np.cov(uv.T))[0], 0.0)) if len(uv) > 3 else 0.0
        shares.append(float(extent) / view.size[1])
    return min(shares)


def _rival(pair: _Pair, ratio: Refinement | None) -> int:
    """Support of the best other pose, searched among the matches that the winner leaves over."""
    if ratio is None:
        return 0
    rest = pair.ratio[~ratio.inliers]
    if len(rest) < 6:
        return 0
    p_i, p_j = pair.points(rest)
    found = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, 0.01)
    return _places(pair, rest[found[1]]) if found else 0


def _calibrated(information: Floats, depth_m: float) -> Floats | None:
    """(6, 6) covariance with the inflation and the floor that made it honest; None if it is not
    determined.
    """
    scale = np.diag([1.0] * 3 + [1.0 / depth_m] * 3)  # positions as shares of the depth
    scaled = np.linalg.inv(scale) @ information @ np.linalg.inv(scale)
    values, vectors = np.linalg.eigh(scaled)
    if not np.isfinite(values).all() or values[0] <= 1e-9 * values[-1]:
        return None
    covariance = COVARIANCE_INFLATION * (
        vectors / values
    ) @ vectors.T + COVARIANCE_FLOOR**2 * np.eye(6)
    back = np.linalg.inv(scale)
    return back @ covariance @ back


def regression_error(pair: _Pair, T: Floats) -> tuple[float, int]:
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
