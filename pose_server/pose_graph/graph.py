"""Where all keyframes are: a robust pose graph, warm-started, with its components kept apart."""

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.pose_graph.layout import FleetInput, placed_clicks
from fleetpose.pose_server.pose_graph.report import solution_of
from fleetpose.pose_server.pose_graph.robust_optimization import robust_optimize
from fleetpose.pose_server.pose_graph.types import ClickFactor, Edge, FleetSolution, SolveSettings
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]

_ROUNDS = 3  # of splitting what outliers held together


def solve_fleet(
    nodes: Sequence[ViewName],
    edges: Sequence[Edge],
    clicks: Sequence[ClickFactor] = (),
    gauge: ViewName | None = None,
    newest: Mapping[str, ViewName] | None = None,
    previous: FleetSolution | None = None,
    settings: SolveSettings = SolveSettings(),  # noqa: B008 (frozen)
    wanted: Collection[ViewName] | None = None,
) -> FleetSolution:
    """Solves for all keyframes.

    Args:
        nodes: the keyframes.
        edges: relative poses between them, at most one per (a, b, kind).
        clicks: the operator's live correspondences. Those between two views with an operator edge
            are in it already.
        gauge: root of its component: stays at the identity.
        newest: newest keyframe per robot; the root of a component without gauge is that of its
            first robot by name.
        previous: the last solution, to start from.
        settings: noise floors and tolerances.
        wanted: keyframes whose covariance is wanted, default: the newest ones; others keep what
            they had in the last solution.

    Raises:
        ValueError: an edge or click names a keyframe that is not among the nodes, or an edge is
            given twice.
    """
    number = {node: k for k, node in enumerate(nodes)}
    newest = newest or {}
    state = FleetInput(
        list(nodes),
        number,
        list(edges),
        placed_clicks(clicks, number),
        gauge,
        newest,
        settings,
        previous,
    )
    state.check()
    known = _known_poses(nodes, previous)
    excluded = _earlier_outliers(edges, previous)
    fresh = _fresh(edges, previous)
    outvoted = 0 if previous is None else previous.outvoted
    layout = state.layout(excluded, known)
    found = robust_optimize(state, layout, excluded, fresh, outvoted)
    judged = found.judged
    for _ in range(_ROUNDS):
        if found.outliers == excluded:
            break
        excluded = found.outliers  # what they alone held together falls apart
        known = [(nodes[layout.root[k]], T) for k, T in enumerate(found.poses)]
        layout = state.layout(excluded, known)
        found = robust_optimize(state, layout, excluded, frozenset(), found.outvoted)
        judged |= found.judged
    asked = set(newest.values() if wanted is None else wanted)
    return solution_of(state, layout, found, asked & set(number), judged, previous)


def _known_poses(
    nodes: Iterable[ViewName], previous: FleetSolution | None
) -> list[tuple[ViewName, Floats] | None]:
    if previous is None:
        return [None for _ in nodes]
    poses = (previous.nodes.get(node) for node in nodes)
    return [None if pose is None else (pose.root, pose.T_root_camera) for pose in poses]


def _earlier_outliers(edges: Iterable[Edge], previous: FleetSolution | None) -> frozenset[int]:
    if previous is None:
        return frozenset()
    earlier = ((k, previous.edges.get(edge.key)) for k, edge in enumerate(edges))
    return frozenset(k for k, judgement in earlier if judgement is not None and judgement.outlier)


def _fresh(edges: Iterable[Edge], previous: FleetSolution | None) -> frozenset[int]:
    """Edges added to an earlier solution; without one there is no consensus that could outvote."""
    if previous is None:
        return frozenset()
    return frozenset(k for k, edge in enumerate(edges) if edge.key not in previous.edges)
