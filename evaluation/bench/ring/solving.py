"""A ring's fleet solved as the server does it: pair alignments and clicks in, positions out.

The solver gets robots under random names and their links in a random order; what is next to what it
is never told.
"""

import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.clicks.worker import ClickedAnswer
from fleetpose.evaluation.data.anonymize import distinct_names
from fleetpose.evaluation.data.recording import TrueView
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import position_error_m
from fleetpose.pose_server.correspondences.on_keyframes import contradicts
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.types import ClickFactor, Edge, FleetSolution, SolveSettings
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import ViewName

_PAPER_SIGMA = 0.01
"""Of the edges of answers without a covariance: share of the depth, and radians."""
_FULL_POSE = 3

Pair = tuple[int, int]
"""Indices of two views."""


Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Solved:
    """What the server would say of a fleet, scored.

    Attributes:
        errors_m: position error by index of the view, of every robot; the anchors have none. One
            that is not located counts too: see `_places`.
        located: share of the robots that are joined with their anchor, the anchors left out.
        marked: by pair, (N,) which clicks the server marks as outliers; none where it cannot tell.
    """

    errors_m: dict[int, float]
    located: float
    marked: dict[Pair, Mask | None]


def solve_ring(
    views: Mapping[int, TrueView],
    answers: Mapping[Pair, ClickedAnswer],
    depth_m: float,
    seed: int = 0,
) -> Solved:
    """Solves for all robots of a ring and scores their positions.

    A ring of which pairs were left out may fall into arcs: each is a fleet of its own, with its
    own anchor, as nothing could tell where they are to each other.

    Args:
        views: by index, with their truth, of the robots.
        answers: of the pairs that were aligned.
        depth_m: median depth of the scene.
        seed: of names and order.
    """
    names, solution = solution_of(views, answers, depth_m, seed)
    arcs = connected(answers)
    anchors = tuple(min(arc, key=lambda index: str(names[index])) for arc in arcs)
    errors: dict[int, float] = {}
    located = 0
    for arc, anchor in zip(arcs, anchors, strict=True):
        for index, T in _places(solution, names, sorted(answers), arc, anchor).items():
            if index != anchor:
                errors[index] = position_error_m(views[anchor].T_to(views[index]), T)
                located += solution.joined(names[anchor], names[index])
    marked = {pair: _marked(solution, names, pair, answers[pair]) for pair in answers}
    return Solved(errors, located / max(len(errors), 1), marked)


def solution_of(
    views: Mapping[int, TrueView],
    answers: Mapping[Pair, ClickedAnswer],
    depth_m: float,
    seed: int = 0,
    covariances: bool = False,
) -> tuple[dict[int, ViewName], FleetSolution]:
    """Names of the robots by index, and what the server's solver makes of the answers.

    Args:
        views, answers, depth_m, seed: like those of `solve_ring`.
        covariances: whether those of all robots are wanted as well.
    """
    rng = random.Random(seed)
    names = {index: ViewName(robot=name, epoch=new_epoch(), seq=0) for index, name in
             zip(views, distinct_names(len(views), rng), strict=True)}  # fmt: skip
    pairs = list(answers)
    rng.shuffle(pairs)
    nodes = sorted(names.values(), key=str)
    solution = solve_fleet(
        nodes,
        [edge for pair in pairs if (edge := _edge(names, pair, answers[pair], depth_m))],
        list(_clicks(names, pairs, answers)),
        newest={name.robot: name for name in nodes},
        settings=SolveSettings.at_depth(depth_m),
        wanted=nodes if covariances else (),
    )
    return names, solution


def _places(
    solution: FleetSolution,
    names: Mapping[int, ViewName],
    pairs: Sequence[Pair],
    arc: set[int],
    anchor: int,
) -> dict[int, Floats]:
    """T_anchor_camera of every robot of an arc, of those that are not located as well.

    Where nothing joins two neighbours, one is taken to stand where the other is. That is where the
    paper's method leaves a pair of which it finds nothing: its start without clicks is the identity
    (its Fig. 7), and there is always an answer. So a robot that this system refuses to locate costs
    as much as one that the paper's method does not move.
    """
    places = _joined_to(solution, names, arc, anchor, np.eye(4))
    while len(places) < len(arc):
        here, there = next(
            ends
            for pair in pairs
            for ends in (pair, pair[::-1])
            if ends[0] in places and ends[1] in arc and ends[1] not in places
        )
        places |= _joined_to(solution, names, arc, there, places[here])
    return places


def _joined_to(
    solution: FleetSolution, names: Mapping[int, ViewName], arc: set[int], root: int, T: Floats
) -> dict[int, Floats]:
    """Poses of a robot and of all that are joined with it, if its own is T."""
    poses = {root: T}
    for index in arc - {root}:
        relative = solution.relative(names[root], names[index])
        if relative is not None:
            poses[index] = T @ np.asarray(relative.T_a_b, np.float64)
    return poses


def connected(pairs: Iterable[Pair]) -> list[set[int]]:
    """The sets of indices that pairs connect."""
    sets: list[set[int]] = []
    for pair in pairs:
        touched = [one for one in sets if one & set(pair)]
        sets = [one for one in sets if not one & set(pair)]
        sets.append(set(pair).union(*touched))
    return sets


def _edge(
    names: Mapping[int, ViewName], pair: Pair, clicked: ClickedAnswer, depth_m: float
) -> Edge | None:
    """The answer as the server files it; an answer without a verdict is believed."""
    answer = clicked.answer
    if answer.T_i_j is None or answer.verdict not in ("", "verified", "plausible"):
        return None
    a, b = names[pair[0]], names[pair[1]]
    if answer.verdict == "":
        sigmas = _PAPER_SIGMA * np.array([1.0] * 3 + [depth_m] * 3)
        return Edge(a, b, answer.T_i_j, np.diag(sigmas**2))
    assert answer.covariance is not None
    enough = len(clicked.at_i.p) >= _FULL_POSE
    operator, grown = answer.confirmed and enough, answer.grown and enough
    verdict = "verified" if answer.verdict == "verified" else "plausible"
    return Edge(a, b, answer.T_i_j, answer.covariance, verdict, operator=operator, grown=grown)


def _clicks(
    names: Mapping[int, ViewName], pairs: Sequence[Pair], answers: Mapping[Pair, ClickedAnswer]
) -> Iterable[ClickFactor]:
    """The clicks that their pair believes, as the server's factors; the paper has no such thing."""
    number = 0
    for pair in pairs:
        clicked, hearing = answers[pair], answers[pair].answer.hearing
        if clicked.answer.verdict == "":
            continue
        for k in range(len(clicked.at_i.p)):
            number += 1
            if hearing is not None and not hearing.accepted[k]:
                continue
            yield ClickFactor(
                names[pair[0]],
                names[pair[1]],
                clicked.at_i.p[k],
                clicked.at_j.p[k],
                clicked.at_i.C[k],
                clicked.at_j.C[k],
                number,
                1.0 if hearing is None else hearing.p_grave,
            )


def _marked(
    solution: FleetSolution, names: Mapping[int, ViewName], pair: Pair, clicked: ClickedAnswer
) -> Mask | None:
    relative = solution.relative(names[pair[0]], names[pair[1]])
    hearing = clicked.answer.hearing
    refused = None if hearing is None else ~np.array(hearing.accepted, bool)
    if relative is None:
        return refused if refused is not None and refused.any() else None
    i, j = clicked.at_i, clicked.at_j
    marked = contradicts(relative.T_a_b, PointPairs(i.p, j.p, i.C, j.C))
    return marked if refused is None else marked | refused
