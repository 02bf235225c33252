"""A settled problem as the frozen solution that the rest of the server reads."""

from collections.abc import Iterable

import gtsam
import numpy as np

from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.pose_graph import factors as gt
from fleetpose.pose_server.pose_graph.layout import FleetInput, Layout
from fleetpose.pose_server.pose_graph.links import CONTESTED, VERDICT_OF_RANK, VERIFIED
from fleetpose.pose_server.pose_graph.robust_optimization import RobustFit, contested_edges
from fleetpose.pose_server.pose_graph.shared_errors import inflations
from fleetpose.pose_server.pose_graph.types import (
    Bridge,
    ClickJudgement,
    EdgeJudgement,
    EdgeKey,
    FleetSolution,
    NodePose,
    Told,
)
from fleetpose.pose_server.pose_graph.witnesses import along_surest_ways
from fleetpose.protocol.messages import ViewName


def solution_of(
    state: FleetInput,
    layout: Layout,
    found: RobustFit,
    wanted: set[ViewName],
    judged: bool,
    previous: FleetSolution | None,
) -> FleetSolution:
    """The solution, with covariances of the wanted nodes; others keep those of an earlier one."""
    contested = contested_edges(layout, found)
    uncertainty = _uncertainty(state, layout, found, wanted)
    return FleetSolution(
        _nodes(state, layout, found, contested, uncertainty, wanted, previous),
        _components(state, layout),
        _edges(state, found, contested),
        _clicks(state, layout, found),
        tuple(_bridge(state, layout, group) for group in layout.parts.bridges),
        judged,
        found.outvoted,
        uncertainty,
        _told(state, found),
    )


def _told(state: FleetInput, found: RobustFit) -> dict[tuple[ViewName, ViewName], Told]:
    return {
        (state.nodes[a], state.nodes[b]): (state.clicked[a, b][0].fingerprint(), summary)
        for (a, b), summary in found.told.items()
    }


def _nodes(
    state: FleetInput,
    layout: Layout,
    found: RobustFit,
    contested: frozenset[int],
    uncertainty: gt.Uncertainty,
    wanted: set[ViewName],
    previous: FleetSolution | None,
) -> dict[ViewName, NodePose]:
    poses: dict[ViewName, NodePose] = {}
    ranks: dict[int, int] = {}
    grave = _grave(layout, found)
    for tree in layout.trees:
        for r in tree:
            node, link = state.nodes[r.node], r.link
            if link is None:
                ranks[r.node] = VERIFIED
            else:
                own = CONTESTED if link.edge in contested else link.rank
                ranks[r.node] = min(ranks[link.a], own)
            root = state.nodes[tree[0].node]
            covariance, why = uncertainty.of(node) if node in wanted else (None, "not asked for")
            earlier = None if previous is None or node in wanted else previous.nodes.get(node)
            if earlier is not None and earlier.root == root:
                covariance, why = earlier.covariance, earlier.why_no_covariance
            poses[node] = NodePose(
                found.poses[r.node],
                root,
                VERDICT_OF_RANK[ranks[r.node]],
                None if link is None else state.nodes[link.a],
                covariance,
                why,
                # nothing vouches for who is held by a link that was found wrong in the last round
                grave.get(r.node, 1.0),
            )
    return poses


def _grave(layout: Layout, found: RobustFit) -> dict[int, float]:
    """Per node the probability that its pose is gravely off beside the root's. Each edge that is
    used is worth what it says itself; clicks that join without an edge are links as well.
    """
    used = [link for link, out in zip(found.links, found.fit.out, strict=True) if not out]
    by_clicks = [
        r.link for tree in layout.trees for r in tree if r.link is not None and r.link.edge is None
    ]
    roots = [tree[0].node for tree in layout.trees]
    return along_surest_ways(roots, [*used, *by_clicks], found.poses)


def _components(state: FleetInput, layout: Layout) -> dict[ViewName, tuple[ViewName, ...]]:
    trees = sorted(layout.trees, key=lambda t: (state.nodes[t[0].node] != state.gauge, -len(t)))
    return {state.nodes[t[0].node]: tuple(state.nodes[r.node] for r in t) for t in trees}


def _edges(
    state: FleetInput, found: RobustFit, contested: frozenset[int]
) -> dict[EdgeKey, EdgeJudgement]:
    unused = EdgeJudgement(0.0, float("nan"), False)
    judgements = {edge.key: unused for edge in state.edges}
    for link, out, distance2 in zip(
        found.links, found.fit.out.tolist(), found.fit.distance2.tolist(), strict=True
    ):
        if link.edge is not None:
            judgements[state.edges[link.edge].key] = EdgeJudgement(
                float(not out), distance2, out, link.edge in contested
            )
    return judgements


def _clicks(state: FleetInput, layout: Layout, found: RobustFit) -> dict[int, ClickJudgement]:
    limit = chi2_limit(1 - state.settings.inlier_probability, 3)
    apart = ClickJudgement(False, float("nan"), float("nan"), False)
    judgements = {}
    for (a, b), (clicked, ids) in state.clicked.items():
        if layout.root[a] != layout.root[b]:
            judgements |= dict.fromkeys(ids, apart)
            continue
        T_a_b = inverse(found.poses[a]) @ found.poses[b]
        distances2 = clicked.distance2(T_a_b)
        residuals = np.linalg.norm(clicked.p_a - transform(T_a_b, clicked.p_b), axis=1)
        used = (a, b) in found.told
        for number, residual, distance2 in zip(ids, residuals, distances2, strict=True):
            judgements[number] = ClickJudgement(
                used, float(residual), float(distance2), bool(distance2 > limit)
            )
    return judgements


def _bridge(state: FleetInput, layout: Layout, group: tuple[int, ...]) -> Bridge:
    edges = tuple(state.edges[k] for k in group)
    a, b = (layout.root[state.number[view]] for view in (edges[0].a, edges[0].b))
    return Bridge(state.nodes[a], state.nodes[b], edges)


def _uncertainty(
    state: FleetInput, layout: Layout, found: RobustFit, wanted: Iterable[ViewName]
) -> gt.Uncertainty:
    """Marginals of the components with wanted nodes, each for itself: a bad one spoils no other.

    Edges of one view share the errors of the points that they have in common (`sharing`). Where
    edges agree better than their covariances say, they are surer than these.
    """
    asked = {layout.root[state.number[node]] for node in wanted}
    graphs = {root: gtsam.NonlinearFactorGraph() for root in asked}
    for root, graph in graphs.items():
        graph.push_back(gt.prior(root, gtsam.Pose3()))
    kept = [link for link, out in zip(found.links, found.fit.out, strict=True) if not out]
    shared = inflations(kept, found.poses, state.settings.shared_share) if kept else ()
    factor = {root: _variance_factor(state, layout, found, root) for root in graphs}
    for link, inflation in zip(kept, shared, strict=True):
        if (root := layout.root[link.a]) in graphs:
            graphs[root].push_back(gt.between(link, factor[root] * float(inflation)))
    for (a, b), told in found.told.items():
        if (root := layout.root[a]) in graphs:
            graphs[root].push_back(gt.click_factor(a, b, told))
    marginals = {
        root: gt.marginals_or_reason(graph, found.fit.values) for root, graph in graphs.items()
    }
    return gt.Uncertainty(state.number, found.poses, marginals, layout.root)


def _variance_factor(state: FleetInput, layout: Layout, found: RobustFit, root: int) -> float:
    """By what a component's edges are to be scaled: the variance of unit weight of its least
    squares, beside what it is where covariances are right.

    Part of every edge's error belongs to its views and shows in no cycle. Few cycles prove little.
    """
    settings = state.settings
    used = [
        distance2
        for link, out, distance2 in zip(
            found.links, found.fit.out, found.fit.distance2, strict=True
        )
        if not out and layout.root[link.a] == root
    ]
    dof = 6 * max(len(used) - layout.root.count(root) + 1, 0)
    prior = settings.unit_weight_dof
    unit_weight = (prior * settings.unit_weight + sum(used)) / (prior + dof)
    return float(np.clip(unit_weight / settings.unit_weight, settings.least_variance, 1.0))
