"""From a start to candidates: refined, searched again around the predicted places, and scored."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pose_server.geometry import robust
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.icp import gicp
from pose_server.geometry.matching import NO_MATCHES
from pose_server.geometry.refine import NoiseScale
from pose_server.geometry.se3 import transform
from pose_server.pairs.pair import Pair

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

_ENOUGH_MATCHES = 300  # to find a pose; all are used to judge it
_LEAST_MATCHES = 6
_SHAPE_RESOLUTION = 0.03  # share of the depth
ROUGH_ICP = (0.03, 0.015, 0.0075)  # radii for coarse starts, shares of the depth
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
class Candidate:
    """A pose, the kind of start that led to it, and its score among all of a pair."""

    start: str
    T_i_j: Floats
    score: float


def candidate(pair: Pair, kind: str, T: Floats) -> Candidate:
    """A scored pose."""
    return Candidate(kind, T, pair.score(T))


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The one that scores best."""
    return max(candidates, key=lambda one: one.score)


def solved(pair: Pair, matches: Indices) -> tuple[Floats, Indices] | None:
    """T_i_j by a robust solver from matches (M, 2) of which most may be wrong, and which agree."""
    if len(matches) < _LEAST_MATCHES:
        return None
    p_i, p_j = pair.points(matches)
    bound = float(np.clip(1.5 * pair.sigma, 0.01, 0.03))
    found = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, bound)
    if found is None:
        return None
    T, agrees = found[0].copy(), found[1]
    T[:3, 3] *= pair.depth_m
    return T, matches[agrees]


def from_shape(pair: Pair) -> list[Candidate]:
    """What ICP and guided matching make of a pose found by the clouds' shapes."""
    T = robust.by_shape(
        pair.i.measured.points, pair.j.measured.points, _SHAPE_RESOLUTION * pair.depth_m
    )
    if not np.isfinite(T).all():
        return []
    found = with_icp(pair, candidate(pair, "shape", T), ROUGH_ICP)
    return from_start(pair, Start("shape", found.T_i_j, ROUGH_ICP[-1]))


def from_matches(pair: Pair, T: Floats, matches: Indices, kind: str) -> list[Candidate]:
    """What refinement makes of a pose that matches agree on: on them, then on all near it, then on
    those found around the predicted places.
    """
    try:
        first = pair.refined(T, matches, _START_NOISE)
        p_i, p_j = pair.points(pair.ratio)
        near = np.linalg.norm(transform(first.T_i_j, p_j) - p_i, axis=1) < 0.05 * pair.depth_m
        if near.sum() >= _LEAST_MATCHES:
            matches = pair.ratio[near]
            first = pair.refined(first.T_i_j, matches, first.noise)
    except DegenerateGeometryError:
        return []
    found = [candidate(pair, kind, first.T_i_j)]
    return found + _guided(pair, kind, first.T_i_j, (0.01, 0.006), matches, first.noise)


def from_start(pair: Pair, start: Start) -> list[Candidate]:
    """A given pose, and what guided matching makes of it with a radius that follows its
    uncertainty.
    """
    found = [candidate(pair, start.kind, start.T_i_j)]
    radii = (min(0.1, 2 * start.sigma), min(0.03, start.sigma), 0.01, 0.006)
    return found + _guided(pair, start.kind, start.T_i_j, radii, NO_MATCHES, _START_NOISE)


def with_icp(pair: Pair, one: Candidate, radii: tuple[float, ...] = (0.015, 0.0075)) -> Candidate:
    """A candidate after ICP with shrinking radii, shares of the depth; itself if that scores
    worse.
    """
    radii_m = tuple(radius * pair.depth_m for radius in radii)
    T = gicp(pair.i.measured.for_icp, pair.j.measured.for_icp, one.T_i_j, radii_m)
    other = candidate(pair, one.start, T)
    return other if other.score > one.score else one


def _guided(
    pair: Pair, kind: str, T: Floats, radii: tuple[float, ...], kept: Indices, noise: NoiseScale
) -> list[Candidate]:
    for radius in radii:
        matches = np.unique(np.concatenate((pair.guided(T, radius), kept)), axis=0)
        if len(matches) < _LEAST_MATCHES:
            return []
        some = matches[:: 1 + len(matches) // _ENOUGH_MATCHES]
        try:
            found = pair.refined(T, some, noise)
        except DegenerateGeometryError:
            return []
        T, noise = found.T_i_j, found.noise
    return [candidate(pair, kind, T)]
