"""From a start to candidates: refined, searched again around the predicted places, and scored."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features import robust
from fleetpose.pose_server.geometry.features.matching import NO_MATCHES, ratio_matches, union
from fleetpose.pose_server.geometry.features.refine import NoiseScale, Refinement
from fleetpose.pose_server.geometry.features.triangles import poses_by_triangles
from fleetpose.pose_server.geometry.icp import gicp
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.geometry.se3 import rotation_angle, transform, weighted_mean
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.pair_icp import IcpReport, registered
from fleetpose.pose_server.registration.verdict.evaluate import EVALUATE
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class RefinementSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    enough_matches: int = 300  # to find a pose; all are used to judge it
    least_matches: int = 6  # matches, to look for a pose
    least_agreeing: int = 5  # matches that agree, to refine one
    nearly: float = 0.6  # as many as agree on the best pose: another is looked at too
    few: float = 0.2  # of all matches: so few may be chance
    as_good: float = 0.94  # share of the best score: a pose elsewhere that has it is judged too
    alike: float = 0.15  # poses nearer to each other are one, share of the depth
    rough_radius: float = 0.08  # reach of ICP from a coarse start, share of the depth
    rough_iterations: int = 10  # of it
    rough_sigma: float = 0.01  # of what comes of it
    shape_sigma: float = 0.01  # of where a shape is, share of its depth
    surface_poses: int = 2  # poses by the shape of surfaces that are looked at
    least_sigma: float = 0.001  # of a surface, share of the depth: no camera is better
    far: float = 0.04  # share of the depth, and radians: surfaces that lead so far away are others
    # The image is trusted first. Where depths are worse than stated, a fit that may widen the
    # pixel noise settles between both; with loose depths it finds the pixels' pose, and then the
    # noise
    start_noise: NoiseScale = NoiseScale(1.0, 4.0)


REFINEMENT = in_use("refinement", RefinementSettings())


@dataclass(frozen=True)
class Start:
    """A pose to begin from, and how far it may be off: `sigma` as a share of the median depth (and
    radians).
    """

    kind: str
    T_i_j: Floats
    sigma: float


@dataclass(frozen=True, eq=False)
class Candidate:
    """A pose of a pair and the kind of start that led to it.

    Attributes:
        information: (6, 6) of the matches that it was refined on, if it was.
        T_by_matches: the pose by these alone, where surfaces have moved it since.
        icp: what ICP did, or would have done, where it was tried.
    """

    pair: Pair
    start: str
    T_i_j: Floats
    information: Floats | None = None
    T_by_matches: Floats | None = None
    icp: IcpReport | None = None

    @cached_property
    def score(self) -> float:
        """See `Pair.score`; a candidate without rivals needs none."""
        return self.pair.score(self.T_i_j)


def best_of(candidates: Sequence[Candidate]) -> Candidate:
    """The one that scores best."""
    return max(candidates, key=lambda one: one.score) if len(candidates) > 1 else candidates[0]


def medoid(pair: Pair, candidates: Sequence[Candidate]) -> Candidate:
    """The middle one of the best and those near it that are as good: noise alone decides which of
    these scores best.
    """
    if len(candidates) < 3:
        return best_of(candidates)
    best = best_of(candidates)
    near = [
        one
        for one in candidates
        if one.score > REFINEMENT.as_good * best.score
        and np.linalg.norm(one.T_i_j[:3, 3] - best.T_i_j[:3, 3]) < REFINEMENT.alike * pair.depth_m
    ]
    if len(near) < 3:
        return best
    places = np.array([one.T_i_j[:3, 3] for one in near])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2).sum(axis=1)
    return near[int(apart.argmin())]


def from_poses(pair: Pair, matches: Indices, kind: str, most: int) -> list[Candidate]:
    """What refinement makes of the poses that matches (M, 2) of lifted points agree on, of which
    most may be wrong: of so many poses at most, and only of those that nearly as many agree on as
    on the best.
    """
    found: list[tuple[float, Refinement, Indices]] = []
    for T, agrees in _coarse_poses(pair, matches):
        if len(agrees) < REFINEMENT.least_agreeing or (
            found and len(agrees) < REFINEMENT.nearly * len(found[0][2])
        ):
            continue
        try:
            refined = pair.refined(T, agrees, REFINEMENT.start_noise, 4)
        except DegenerateGeometryError:
            continue
        found.append(
            (pair.scored(refined.T_i_j, matches, REFINEMENT.start_noise).support, refined, agrees)
        )
    found.sort(key=lambda one: -one[0])
    candidates = []
    for support, refined, agrees in found[:most]:
        if support >= REFINEMENT.nearly * found[0][0]:
            candidates += from_matches(pair, refined.T_i_j, agrees, kind)
    return candidates


def _coarse_poses(pair: Pair, matches: Indices) -> list[tuple[Floats, Indices]]:
    """By triangles; where few agree, also by a solver that forgives depths all wrong alike."""
    found = poses_by_triangles(pair.i.observed, pair.j.observed, matches, pair.depth_m)
    if (found and len(found[0][1]) > REFINEMENT.few * len(matches)) or len(
        matches
    ) < REFINEMENT.least_matches:
        return found
    p_i, p_j = pair.points(matches)
    bound = float(np.clip(1.5 * pair.sigma, 0.01, 0.03))
    solved = robust.solve(p_i / pair.depth_m, p_j / pair.depth_m, bound)
    if solved is None:
        return found
    T, agrees = solved[0].copy(), solved[1]
    T[:3, 3] *= pair.depth_m
    return [*found, (T, matches[agrees])]


def from_surfaces(pair: Pair) -> list[Candidate]:
    """What dense clouds make of coarse poses of which hardly any matches tell the right one.

    Matches by shape join those by descriptor; all their poses go through a rough ICP, and the ones
    at which the surfaces agree best are looked at again.
    """
    shapes_i, shapes_j = (view.measured.shapes(pair.depth_m) for view in (pair.i, pair.j))
    alike, _ = ratio_matches(shapes_i.descriptors, shapes_j.descriptors, 1.0)
    first = [len(view.observed.uv) for view in (pair.i, pair.j)]
    views = [
        view.observed.with_points(shapes.points, REFINEMENT.shape_sigma)
        for view, shapes in ((pair.i, shapes_i), (pair.j, shapes_j))
    ]
    matches = np.concatenate((alike + first, pair.ratio))
    found = []
    for T, _ in poses_by_triangles(views[0], views[1], matches, pair.depth_m):
        rough = gicp(
            pair.i.measured.for_rough_icp,
            pair.j.measured.for_rough_icp,
            T,
            REFINEMENT.rough_radius * pair.depth_m,
            REFINEMENT.rough_iterations,
        ).T_i_j
        seen = pair.agreement(rough)
        found.append(((seen.mean_agree - seen.through) * seen.overlap**0.5, rough))
    found.sort(key=lambda one: -one[0])
    return [
        one
        for _, T in found[: REFINEMENT.surface_poses]
        for one in from_start(pair, Start("shape", T, REFINEMENT.rough_sigma))
    ]


def from_matches(pair: Pair, T: Floats, matches: Indices, kind: str) -> list[Candidate]:
    """What refinement makes of a pose that matches agree on: on them, then on all near it, then on
    those found around the predicted places.
    """
    try:
        first = pair.refined(T, matches, REFINEMENT.start_noise)
        p_i, p_j = pair.points(pair.ratio)
        near = np.linalg.norm(transform(first.T_i_j, p_j) - p_i, axis=1) < 0.05 * pair.depth_m
        if near.sum() >= REFINEMENT.least_matches:
            matches = pair.ratio[near]
            first = pair.refined(first.T_i_j, matches, first.noise)
    except DegenerateGeometryError:
        return []
    guided = _guided(pair, kind, first.T_i_j, (0.01, 0.006), matches, first.noise)
    return guided or [Candidate(pair, kind, first.T_i_j, first.information)]


def from_start(pair: Pair, start: Start) -> list[Candidate]:
    """A given pose, and what guided matching makes of it with a radius that follows its
    uncertainty.
    """
    found = [Candidate(pair, start.kind, start.T_i_j)]
    radii = (min(0.1, 2 * start.sigma), min(0.03, start.sigma), 0.01, 0.006)
    return found + _guided(pair, start.kind, start.T_i_j, radii, NO_MATCHES, REFINEMENT.start_noise)


def with_surfaces(pair: Pair, one: Candidate) -> Candidate:
    """A candidate from matches after it has yielded to the surfaces of dense clouds as far as both
    are sure; itself where they lead elsewhere.

    Either errs in its own way: matches by the depths at some edges and corners, surfaces by what
    slides along them. The joint fit is the mean of both, weighed by their information.
    """
    if one.information is None or not (pair.i.dense and pair.j.dense):
        return one
    found = registered(pair, one.T_i_j, "gicp")
    if found is None or found.fit is None:
        return one
    fit = found.fit
    shift = float(np.linalg.norm(fit.T_i_j[:3, 3] - one.T_i_j[:3, 3])) / pair.depth_m
    turn_rad = rotation_angle(fit.T_i_j[:3, :3].T @ one.T_i_j[:3, :3])
    if not (max(shift, turn_rad) < REFINEMENT.far and np.isfinite(fit.hessian).all()):
        return replace(one, icp=found.report)
    surfaces = fit.hessian / (max(pair.sigma, REFINEMENT.least_sigma) * pair.depth_m) ** 2
    matches = one.information / EVALUATE.covariance_inflation
    T = weighted_mean(one.T_i_j, matches, fit.T_i_j, surfaces)
    told = replace(found.report, kept=True)
    return replace(one, T_i_j=T, T_by_matches=one.T_i_j, icp=told)


def with_icp(pair: Pair, one: Candidate, method: IcpMethod) -> Candidate:
    """A candidate after ICP; itself, and what became of it, if that scores worse."""
    found = registered(pair, one.T_i_j, method)
    if found is None:
        return one
    told = replace(found.report, kept=True)
    other = Candidate(pair, one.start, found.T_i_j, one.information, icp=told)
    return other if other.score > one.score else replace(one, icp=found.report)


def _guided(
    pair: Pair, kind: str, T: Floats, radii: tuple[float, ...], kept: Indices, noise: NoiseScale
) -> list[Candidate]:
    found = None
    for radius in radii:
        matches = union(pair.guided(T, radius, both_ways=radius == radii[-1]), kept)
        if len(matches) < REFINEMENT.least_matches:
            return []
        some = matches[:: 1 + len(matches) // REFINEMENT.enough_matches]
        try:
            found = pair.refined(T, some, noise)
        except DegenerateGeometryError:
            return []
        T, noise = found.T_i_j, found.noise
    return [Candidate(pair, kind, T, None if found is None else found.information)]
