"""Finds poses and outliers that fit each other.

Between changes that could hide a wrong edge, plain least squares is enough. When edges contradict
each other, new ones that a redundant graph outvotes are set aside at once; else all are weighed
against each other from scratch.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.pose_graph import factors as gt
from fleetpose.pose_server.pose_graph.forest import Forest, Reached, Sets, without_bridges
from fleetpose.pose_server.pose_graph.layout import FleetInput, Layout
from fleetpose.pose_server.pose_graph.links import CONFIRMED, CONTESTED, VERIFIED, Link

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]

_ROUNDS = 3  # of dropping edges at the border and taking back those that fit
_OUTVOTED_ONE_IN = 16  # of the links may be set aside until all are weighed again
_CLICK_ROUNDS = 5  # of asking clicks again from where they led to
_CLICK_SHARE = 0.02  # of how far agreeing edges may differ: what poses may move without asking


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares answer.

    Attributes:
        out: (M,) which links were left out.
        graph, values: the problem and its answer.
        distance2: (M,) squared Mahalanobis distance of every link, also of those left out.
    """

    out: Bools
    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    distance2: Floats


@dataclass(frozen=True, eq=False)
class RobustFit:
    """What was settled.

    Attributes:
        fit: the poses and outliers that fit each other.
        links: all links with both ends in one component, as `fit` orders them.
        told: by the numbers of two nodes, what their clicks said as a factor of their own.
        judged: whether all edges were weighed against each other.
        outvoted: how many were set aside without that since the last time.
    """

    fit: Fit
    links: list[Link]
    told: dict[tuple[int, int], gt.ClickSummary]
    judged: bool
    outvoted: int

    @cached_property
    def poses(self) -> list[Floats]:
        """(4, 4) T_root_node per node."""
        return gt.poses_in(self.fit.values)

    @property
    def outliers(self) -> frozenset[int]:
        """Numbers of the edges left out."""
        pairs = zip(self.links, self.fit.out, strict=True)
        return frozenset(link.edge for link, out in pairs if out and link.edge is not None)


def robust_optimize(
    state: FleetInput,
    layout: Layout,
    excluded: frozenset[int],
    fresh: frozenset[int],
    outvoted: int,
) -> RobustFit:
    """Poses and outliers that fit: every used edge is within the limit, every outlier beyond.

    Args:
        state: the input.
        layout: components and start values.
        excluded: numbers of the edges that were outliers so far.
        fresh: numbers of the edges that no earlier solution knew.
        outvoted: how many edges were set aside without weighing all since that was last done.
    """
    problem = _Problem(state, layout)
    needed = {r.link.edge for tree in layout.trees for r in tree if r.link is not None}
    without = excluded - needed
    out = np.array([link.edge in without for link in problem.links], bool)
    fit = problem.solve(out)
    if not problem.violations(fit).any():
        return problem.found(fit, False, outvoted)
    new = np.array([link.edge in fresh for link in problem.links], bool) & problem.beyond_at_start()
    most = max(state.settings.outvoted_limit, len(problem.links) // _OUTVOTED_ONE_IN)
    periodic = outvoted + int(new.sum()) > most
    if new.any() and not periodic:
        fit = problem.solve(out | new)
        if not problem.violations(fit).any() and _outvoted(layout, problem.links, fit.out, new):
            return problem.found(fit, False, outvoted + int(new.sum()))
    fit = problem.solve(problem.judged(np.zeros_like(out) if periodic else out))
    for _ in range(_ROUNDS):
        violations = problem.violations(fit)
        if not violations.any():
            break
        fit = problem.solve(fit.out | violations)
    return problem.found(fit, True, 0 if periodic else outvoted)


class _Problem:
    """One layout as a least-squares problem, to be solved for several sets of outliers."""

    def __init__(self, state: FleetInput, layout: Layout) -> None:
        root = layout.root
        self._settings = state.settings
        self.links = [link for link in state.links if root[link.a] == root[link.b]]
        merged = {
            frozenset((link.a, link.b))
            for link in state.links
            if link.edge is not None and state.edges[link.edge].grown
        }
        self._clicked = {
            (a, b): clicked
            for (a, b), (clicked, _) in state.clicked.items()
            if root[a] == root[b] and frozenset((a, b)) not in merged
        }
        edges = [state.edges[link.edge] for link in self.links if link.edge is not None]
        self._certain = np.array(
            [edge.kind == "odometry" and edge.verdict == "verified" for edge in edges], bool
        )
        self._factors = [state.factors[link.edge] for link in self.links if link.edge is not None]
        self.told = {nodes: told for nodes, told in state.told.items() if nodes in self._clicked}
        self._always = [gt.prior(tree[0].node, gtsam.Pose3()) for tree in layout.trees]
        self._start = gt.values_of(layout.start)
        self._n = len(state.nodes)
        self._limit = chi2_limit(1 - state.settings.inlier_probability, 6)

    def solve(self, out: Bools) -> Fit:
        """Least squares without the outliers; those that then fit come back."""
        fit = self._least_squares(out, self._start)
        for _ in range(_ROUNDS):
            fits = fit.out & (fit.distance2 <= self._limit)
            if not fits.any():
                break
            fit = self._least_squares(fit.out & ~fits, fit.values)
        return fit

    def violations(self, fit: Fit) -> Bools:
        """Used links that don't fit."""
        return (fit.distance2 > self._limit) & ~fit.out & ~self._certain

    def beyond_at_start(self) -> Bools:
        """Links that don't fit the start values."""
        return gt.distances2(self._factors, self._start) > self._limit

    def judged(self, aside: Bools) -> Bools:
        """Outliers by graduated non-convexity, those set aside left out of it: the verified links
        among themselves, then those that an operator confirmed against what these hold together,
        then the others. Aliases of a repeated structure agree with each other, so a majority of
        plausible links proves nothing against a better one.
        """
        ranks = np.array([link.rank for link in self.links], int)
        left = ~aside & ~self._certain
        trusted = self._certain
        for least in (VERIFIED, CONFIRMED, CONTESTED):
            asked = left & (ranks >= least)
            if asked.any():
                trusted = self._agreeing(trusted | asked, trusted)
            left &= ~asked
        return ~trusted & ~self._certain

    def _agreeing(self, asked: Bools, known: Bools) -> Bools:
        """(M,) which of the asked links belong together; the known ones are not in question."""
        numbers = np.nonzero(asked)[0]
        if known[numbers].all():
            return asked
        sets = Sets(self._n)
        for k in numbers:
            sets.join(self.links[k].a, self.links[k].b)
        inliers = gt.judge(
            [self._factors[k] for k in numbers],
            np.nonzero(known[numbers])[0].tolist(),
            sorted({sets.find(k) for k in range(self._n)}),
            self._start,
            self._settings.inlier_probability,
        )
        agreeing = np.zeros(len(self.links), bool)
        agreeing[numbers] = inliers | known[numbers]
        return agreeing

    def found(self, fit: Fit, judged: bool, outvoted: int) -> RobustFit:
        return RobustFit(fit, self.links, self.told, judged, outvoted)

    def _least_squares(self, out: Bools, start: gtsam.Values) -> Fit:
        kept = [factor for factor, drop in zip(self._factors, out, strict=True) if not drop]
        graph, values = self._with_clicks(kept, start, near=False), start
        for _ in range(_CLICK_ROUNDS):
            values = gt.least_squares(graph, values)
            if self._heeds_clicks(values):
                break
            graph = self._with_clicks(kept, values, near=True)  # they say something else from there
        return Fit(out, graph, values, gt.distances2(self._factors, values))

    def _with_clicks(
        self, kept: Sequence[gtsam.NonlinearFactor], at: gtsam.Values, near: bool
    ) -> gtsam.NonlinearFactorGraph:
        """The problem, with what clicks say at given poses."""
        robust = self._settings.click_robust_sigmas
        for (a, b), clicked in self._clicked.items():
            T_a_b = gt.between_poses(at, a, b)
            told = self.told.get((a, b))
            if told is None or not self._still_holds(told, T_a_b) or (near and not told.near):
                summary = gt.summed_up(clicked, T_a_b, robust, near)
                if summary is not None:
                    self.told[a, b] = summary
        by_clicks = (gt.click_factor(a, b, summary) for (a, b), summary in self.told.items())
        return gt.graph_of(self._always, kept, by_clicks)

    def _heeds_clicks(self, values: gtsam.Values) -> bool:
        """Whether the clicks of every pair of keyframes would say nothing new."""
        return all(
            told.near and self._still_holds(told, gt.between_poses(values, a, b))
            for (a, b), told in self.told.items()
        )

    def _still_holds(self, told: gt.ClickSummary, T_a_b: Floats) -> bool:
        change = told.at @ inverse(T_a_b)
        turned = rotation_angle(change[:3, :3]) > _CLICK_SHARE * self._settings.agree_rotation_rad
        moved = np.linalg.norm(change[:3, 3]) > _CLICK_SHARE * self._settings.agree_translation_m
        return not (turned or moved)


def contested_edges(layout: Layout, found: RobustFit) -> frozenset[int]:
    """Bridges that an equally trusted edge contradicts: one of the two is wrong, but which?"""
    if not found.fit.out.any():
        return frozenset()
    sets = _firm(layout, found.links, found.fit.out)
    reached = {r.node: r for tree in layout.trees for r in tree}
    contested = set()
    for link, out in zip(found.links, found.fit.out, strict=True):
        for step in _path(reached, link.a, link.b) if out else ():
            bridge = sets.find(step.a) != sets.find(step.b)
            if bridge and step.edge is not None and link.rank >= step.rank:
                contested.add(step.edge)
    return frozenset(contested)


def _outvoted(layout: Layout, links: list[Link], out: Bools, new: Bools) -> bool:
    """Whether the new links left out may stay so without weighing all: they contradict parts that
    links of no lower rank hold together without any single one, or a single one that nothing else
    contradicts. There it is one against one, and weighing could not tell which is right.
    """
    aside = [link for link, is_out in zip(links, out & new, strict=True) if is_out]
    against = [link for link, is_out in zip(links, out, strict=True) if is_out]
    reached = {r.node: r for tree in layout.trees for r in tree}
    for rank in {link.rank for link in aside}:
        firm = _firm(layout, links, out, rank)
        doubted = Counter(
            step.edge
            for link in against
            for step in _path(reached, link.a, link.b)
            if firm.find(step.a) != firm.find(step.b)
        )
        for link in aside:
            steps = _path(reached, link.a, link.b) if link.rank == rank else ()
            if any(doubted[s.edge] > 1 for s in steps if firm.find(s.a) != firm.find(s.b)):
                return False
    return True


def _firm(layout: Layout, links: list[Link], out: Bools, rank: int = CONTESTED) -> Sets:
    """Sets of nodes that inliers of a rank or a higher one join in more than one way."""
    n = len(layout.root)
    forest = Forest(n)
    inliers = [
        link for link, is_out in zip(links, out, strict=True) if not is_out and link.rank >= rank
    ]
    by_clicks = [
        r.link
        for tree in layout.trees
        for r in tree
        if r.link is not None and r.link.edge is None and r.link.rank >= rank
    ]
    chords = [(link.a, link.b) for link in (*by_clicks, *inliers) if not forest.join(link)]
    roots = [k for k in range(n) if forest.component(k) == k]
    return without_bridges(n, [r for k in roots for r in forest.walk(k, 0)], chords)


def _path(reached: Mapping[int, Reached], a: int, b: int) -> list[Link]:
    """The links of the tree between two nodes of it."""
    path = []
    while a != b:
        lower = a if reached[a].depth >= reached[b].depth else b
        link = reached[lower].link
        assert link is not None  # the paths meet before the root of the tree
        path.append(link)
        a, b = (link.a, b) if lower == a else (a, link.a)
    return path
