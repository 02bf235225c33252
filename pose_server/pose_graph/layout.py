"""The solver's input by number: which keyframes are solved together, and from what start."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.pose_graph.components import Partition, hint_from, partition
from fleetpose.pose_server.pose_graph.factors import ClickSummary, between
from fleetpose.pose_server.pose_graph.forest import Reached
from fleetpose.pose_server.pose_graph.links import VERIFIED, Link, joins_alone, links_of
from fleetpose.pose_server.pose_graph.types import ClickFactor, Edge, FleetSolution, SolveSettings
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]
Known = Sequence[tuple[ViewName, Floats] | None]
"""Per node the root and T_root_node of an earlier solution, None where the node is new."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Components as they are solved: per node the root, the way to it and the start value."""

    parts: Partition
    trees: list[list[Reached]]
    root: list[int]
    start: list[Floats]


@dataclass(frozen=True, eq=False)
class FleetInput:
    """The input, by number."""

    nodes: list[ViewName]
    number: dict[ViewName, int]
    edges: list[Edge]
    clicks: list[tuple[int, int, ClickFactor]]
    gauge: ViewName | None
    newest: Mapping[str, ViewName]
    settings: SolveSettings
    previous: FleetSolution | None = None

    def check(self) -> None:
        keys = [edge.key for edge in self.edges]
        if len(set(keys)) != len(keys):
            raise ValueError(f"{len(keys) - len(set(keys))} edges are given twice")
        for edge in self.edges:
            if edge.a not in self.number or edge.b not in self.number or edge.a == edge.b:
                raise ValueError(f"edge {edge.a} - {edge.b} does not join two of the keyframes")

    @cached_property
    def links(self) -> list[Link]:
        return links_of(self.edges, self.number, self.settings)

    @cached_property
    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """One per link, by the number of its edge."""
        return {link.edge: between(link) for link in self.links if link.edge is not None}

    @cached_property
    def clicked(self) -> dict[tuple[int, int], tuple[PointPairs, list[int]]]:
        """The clicked points of every pair of nodes, as the clicks name it, and their ids."""
        by_nodes: dict[tuple[int, int], list[ClickFactor]] = {}
        for a, b, click in self.clicks:
            by_nodes.setdefault((a, b), []).append(click)
        return {
            nodes: (point_pairs(clicks), [click.id for click in clicks])
            for nodes, clicks in by_nodes.items()
        }

    @cached_property
    def told(self) -> dict[tuple[int, int], ClickSummary]:
        """What those pairs of nodes said in the last solve whose clicks are the same still."""
        earlier = {} if self.previous is None else self.previous.told
        found = {}
        for (a, b), (clicked, _) in self.clicked.items():
            before = earlier.get((self.nodes[a], self.nodes[b]))
            if before is not None and before[0] == clicked.fingerprint():
                found[a, b] = before[1]
        return found

    def layout(self, excluded: frozenset[int], known: Known) -> Layout:
        joining = frozenset(k for k, edge in enumerate(self.edges) if joins_alone(edge))
        parts = partition(
            self.nodes,
            self.links,
            joining,
            excluded,
            self.clicks,
            hint_from(known),
            self.settings,
        )
        trees = [parts.forest.walk(root, VERIFIED) for root in self._roots(parts)]
        root = [0] * len(self.nodes)
        start: list[Floats] = [np.eye(4) for _ in self.nodes]
        for tree in trees:
            for k, T in _placed(tree, known).items():
                root[k], start[k] = tree[0].node, T
        return Layout(parts, trees, root, start)

    def _roots(self, parts: Partition) -> list[int]:
        """One per tree: the gauge, else the newest of the first robot by name, else the first."""
        newest = [self.newest[robot] for robot in sorted(self.newest)]
        preferred = [view for view in (self.gauge, *newest) if view in self.number]
        roots: dict[int, int] = {}
        for k in (*(self.number[view] for view in preferred if view), *range(len(self.nodes))):
            roots.setdefault(parts.forest.component(k), k)
        return list(roots.values())


def placed_clicks(
    clicks: Iterable[ClickFactor], number: dict[ViewName, int]
) -> list[tuple[int, int, ClickFactor]]:
    """Clicks with the numbers of their two nodes.

    Raises:
        ValueError: a click names a view that is not among the nodes.
    """
    try:
        return [(number[click.a], number[click.b], click) for click in clicks]
    except KeyError as error:
        raise ValueError(f"a click names {error}, which is not among the keyframes") from error


def point_pairs(clicks: Sequence[ClickFactor]) -> PointPairs:
    """The points of clicks that have their two keyframes in common."""
    columns = zip(*((c.p_a, c.p_b, c.C_a, c.C_b) for c in clicks), strict=True)
    return PointPairs(*(np.array(column) for column in columns))


def _placed(tree: list[Reached], known: Known) -> dict[int, Floats]:
    """Start values of a tree: earlier relative poses are kept, new nodes follow the links."""
    members: dict[ViewName, list[int]] = {}
    for reached in tree:
        if (earlier := known[reached.node]) is not None:
            members.setdefault(earlier[0], []).append(reached.node)
    placed: dict[int, Floats] = {}
    for reached in tree:
        k = reached.node
        if k not in placed:
            placed[k] = (
                np.eye(4) if reached.link is None else placed[reached.link.a] @ reached.link.T_a_b
            )
        earlier = known[k]
        if earlier is not None:
            T_root_frame = placed[k] @ inverse(earlier[1])
            for m in members.pop(earlier[0], ()):
                placed.setdefault(m, T_root_frame @ known[m][1])  # type: ignore[index]
    return placed
