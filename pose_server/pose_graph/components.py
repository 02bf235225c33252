"""Which keyframes are joined: the bridge rule.

An edge alone between two components always fits, so no solver can tell whether it is wrong.
Components are therefore joined only by a verified edge, by the operator (an edge grown from clicks,
or three clicks that the images do not contradict), by a robot's own odometry, or by plausible edges
that are independent witnesses (`witnesses`) and agree in a cycle. What is left over are bridges to
ask about.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import (
    compose_covariance,
    hat,
    inverse,
    log_so3,
    rotation_angle,
    transform,
)
from fleetpose.pose_server.pose_graph.forest import Forest
from fleetpose.pose_server.pose_graph.from_clicks import pose_from_clicks
from fleetpose.pose_server.pose_graph.links import CONFIRMED, Link, link
from fleetpose.pose_server.pose_graph.types import ClickFactor, SolveSettings
from fleetpose.pose_server.pose_graph.witnesses import all_grave, independent, some_grave
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]
Hint = Callable[[int, int], Floats | None]
"""T_a_b of two nodes from an earlier solution, None where it has none."""

_MOST_COMPARED = 8  # plausible edges of one pair of components that are compared with each other


@dataclass(frozen=True, eq=False)
class Partition:
    """Trees of keyframes, and per pair of trees the plausible edges that do not join them."""

    forest: Forest
    bridges: tuple[tuple[int, ...], ...]


def partition(
    names: Sequence[ViewName],
    links: Sequence[Link],
    joining: frozenset[int],
    excluded: frozenset[int],
    clicks: Iterable[tuple[int, int, ClickFactor]],
    hint: Hint,
    settings: SolveSettings,
) -> Partition:
    """Joins keyframes as far as the evidence allows.

    Args:
        names: the keyframes.
        links: of the edges that are used.
        joining: numbers of the edges that join alone.
        excluded: numbers of edges found to be wrong; taken only where nothing else joins.
        clicks: the operator's clicks with the numbers of their two nodes.
        hint: relative poses of an earlier solution.
        settings: tolerances.
    """
    forest = Forest(len(names))
    strongest = sorted(
        (one for one in links if one.edge in joining),
        key=lambda one: (one.edge in excluded, -one.rank, one.size_m),
    )
    for one in strongest:
        forest.join(one)
    agreement = _Agreement(forest, names, hint, settings)
    clicks = [click for click in clicks if click[2].joins]
    doubtful = [one for one in links if one.edge not in joining and one.edge not in excluded]
    doubtful.sort(key=lambda one: (one.p_grave, one.size_m))
    while _join_by_agreement(agreement, doubtful) or _join_by_clicks(agreement, clicks):
        pass
    groups = _between(forest, doubtful)
    return Partition(forest, tuple(tuple(_edges(group)) for group in groups.values()))


def _edges(links: Iterable[Link]) -> list[int]:
    return [one.edge for one in links if one.edge is not None]


def _between(forest: Forest, links: Iterable[Link]) -> dict[tuple[int, int], list[Link]]:
    """Links between different trees, by pair of trees, all in the direction of the pair."""
    groups: dict[tuple[int, int], list[Link]] = defaultdict(list)
    for one in links:
        a, b = forest.component(one.a), forest.component(one.b)
        if a < b:
            groups[a, b].append(one)
        elif b < a:
            groups[b, a].append(one.reversed())
    return groups


@dataclass(frozen=True, eq=False)
class _Agreement:
    """Whether links close a cycle through the trees they connect."""

    forest: Forest
    names: Sequence[ViewName]
    hint: Hint
    settings: SolveSettings

    def within(self, a: int, b: int) -> tuple[Floats, Floats]:
        """T_a_b and its covariance within one tree."""
        if a == b:
            return np.eye(4), np.zeros((6, 6))
        T, covariance = self.forest.path(a, b)
        known = self.hint(a, b)
        return (T if known is None else known), covariance

    def distinct(self, one: Link, two: Link) -> bool:
        """Whether two links between the same trees are different evidence."""
        return any(
            self.names[m].robot != self.names[k].robot
            or np.linalg.norm(self.within(m, k)[0][:3, 3]) > self.settings.distinct_m
            for m, k in ((one.a, two.a), (one.b, two.b))
        )

    def closes(self, cycle: Sequence[Link]) -> bool:
        """Whether links, each beginning in the tree where the last one ended, lead back."""
        T, covariance = np.eye(4), np.zeros((6, 6))
        for one, (step, C) in zip(cycle, self._gaps(cycle), strict=True):
            for T_next, C_next in ((one.T_a_b, one.left), (step, C)):
                covariance = compose_covariance(T, covariance, C_next)
                T = T @ T_next
        turn, shift = rotation_angle(T[:3, :3]), float(np.linalg.norm(T[:3, 3]))
        if turn > self.settings.agree_rotation_rad or shift > self.settings.agree_translation_m:
            return False
        xi = np.concatenate((log_so3(T[:3, :3]), T[:3, 3]))
        distance2 = float(xi @ np.linalg.solve(covariance, xi))
        return distance2 < chi2_limit(1 - self.settings.inlier_probability, 6)

    def bear_witness(self, cycle: Sequence[Link]) -> bool:
        """Whether the links of a cycle agree, and none of them only repeats another one."""
        if not self.closes(cycle):
            return False
        T, structures = np.eye(4), []
        for one, (step, _) in zip(cycle, self._gaps(cycle), strict=True):
            structures.append(None if one.structure is None else one.structure.seen_from(T))
            T = T @ one.T_a_b @ step
        return independent(structures)

    def witnesses(self, group: Sequence[Link]) -> tuple[list[Link], float]:
        """Links between two trees of which each two are different evidence and agree, the surest
        first, and the probability that all of them are gravely off.
        """
        chosen: list[Link] = []
        for one in group:
            if all(
                self.distinct(one, other) and self.bear_witness((other, one.reversed()))
                for other in chosen
            ):
                chosen.append(one)
        return chosen, all_grave([one.p_grave for one in chosen])

    def _gaps(self, cycle: Sequence[Link]) -> list[tuple[Floats, Floats]]:
        """From the end of each link to the begin of the next one, within their tree."""
        return [self.within(a.b, b.a) for a, b in zip(cycle, (*cycle[1:], cycle[0]), strict=True)]


def _join_by_agreement(agreement: _Agreement, doubtful: Sequence[Link]) -> bool:
    """Joins trees by plausible links that are independent witnesses: some between the same trees,
    or a triangle.
    """
    forest, limit = agreement.forest, agreement.settings.most_grave
    groups = _between(forest, doubtful)
    joined = False
    for group in groups.values():
        chosen, p_grave = agreement.witnesses(group[:_MOST_COMPARED])
        if len(chosen) > 1 and p_grave <= limit:
            joined |= forest.join(replace(chosen[0], p_grave=p_grave))
    if joined:
        return True  # the trees are others now
    neighbours: dict[int, set[int]] = defaultdict(set)
    for a, b in groups:
        neighbours[a].add(b)
    for (a, b), group in groups.items():
        for c in sorted(neighbours[a] & neighbours[b]):
            cycle = (group[0], groups[b, c][0], groups[a, c][0].reversed())
            p_grave = some_grave([one.p_grave for one in cycle])
            separate = len({forest.component(k) for k in (a, b, c)}) == 3
            if separate and p_grave <= limit and agreement.bear_witness(cycle):
                for one in cycle[:2]:
                    joined |= forest.join(replace(one, p_grave=p_grave))
    return joined


def _join_by_clicks(agreement: _Agreement, clicks: Sequence[tuple[int, int, ClickFactor]]) -> bool:
    """Joins the first two trees whose clicks, made in whatever views, give a relative pose."""
    forest = agreement.forest
    groups: dict[tuple[int, int], list[tuple[int, int, ClickFactor]]] = defaultdict(list)
    for a, b, click in clicks:
        if (pair := (forest.component(a), forest.component(b)))[0] != pair[1]:
            groups[min(pair), max(pair)].append((a, b, click))
    for (tree, _), group in groups.items():
        if len(group) < 3:
            continue
        oriented = [
            (a, b, c.p_a, c.p_b, c.C_a, c.C_b)
            if forest.component(a) == tree
            else (b, a, c.p_b, c.p_a, c.C_b, c.C_a)
            for a, b, c in group
        ]
        ref_a, ref_b = oriented[0][:2]
        in_a = [_moved(agreement, ref_a, a, p, C) for a, _, p, _, C, _ in oriented]
        in_b = [_moved(agreement, ref_b, b, p, C) for _, b, _, p, _, C in oriented]
        columns = (
            np.array(column) for column in (*zip(*in_a, strict=True), *zip(*in_b, strict=True))
        )
        p_a, C_a, p_b, C_b = columns
        try:
            T, covariance = pose_from_clicks(
                PointPairs(p_a, p_b, C_a, C_b), agreement.settings.inlier_probability
            )
        except DegenerateGeometryError:
            continue  # they stay apart; the clicks wait for more
        p_grave = max(click.p_grave for _, _, click in group)
        return forest.join(link(ref_a, ref_b, T, covariance, CONFIRMED, p_grave))
    return False


def _moved(
    agreement: _Agreement, ref: int, node: int, p: Floats, C: Floats
) -> tuple[Floats, Floats]:
    """A point of a node and its covariance in the frame of another node of the tree."""
    T, covariance = agreement.within(ref, node)
    q = transform(T, p[None])[0]
    J = np.concatenate((-hat(q), np.eye(3)), axis=1)
    R = T[:3, :3]
    return q, R @ C @ R.T + J @ covariance @ J.T


def hint_from(poses: Sequence[tuple[ViewName, Floats] | None]) -> Hint:
    """A hint from earlier poses (root, T_root_node) per node, None where a node is new."""

    def hint(a: int, b: int) -> Floats | None:
        at_a, at_b = poses[a], poses[b]
        if at_a is None or at_b is None or at_a[0] != at_b[0]:
            return None
        return inverse(at_a[1]) @ at_b[1]

    return hint
