"""Trees of links between keyframes: who is joined to whom, and by how many paths."""

from collections import deque
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import compose_covariance
from fleetpose.pose_server.pose_graph.links import Link

Floats = npt.NDArray[np.floating]


class Sets:
    """Disjoint sets of the numbers 0 .. n - 1."""

    def __init__(self, n: int) -> None:
        self._up = list(range(n))

    def find(self, k: int) -> int:
        while self._up[k] != k:
            self._up[k] = k = self._up[self._up[k]]
        return k

    def join(self, upper: int, lower: int) -> bool:
        """Joins both sets; the representative of `upper` stays. False if they were one."""
        upper, lower = self.find(upper), self.find(lower)
        self._up[lower] = upper
        return upper != lower


@dataclass(frozen=True, eq=False)
class Reached:
    """A node of a tree as seen from its root.

    Attributes:
        link: the last one on the way to it, None for the root.
        rank: the weakest on the way.
        depth: number of links on the way.
    """

    node: int
    link: Link | None
    rank: int
    depth: int


class Forest:
    """Trees that grow by links; a link within a tree is refused."""

    def __init__(self, n: int) -> None:
        self._sets = Sets(n)
        self._out: list[list[Link]] = [[] for _ in range(n)]
        self.n = n

    def component(self, node: int) -> int:
        """A number that all nodes of one tree share, until the next join."""
        return self._sets.find(node)

    def join(self, link: Link) -> bool:
        """Adds a link between two trees; False if both nodes are in one tree."""
        if not self._sets.join(link.a, link.b):
            return False
        self._out[link.a].append(link)
        self._out[link.b].append(link.reversed())
        return True

    def walk(self, root: int, best: int) -> list[Reached]:
        """All nodes of the root's tree, parents before children; the root has rank `best`."""
        reached = [Reached(root, None, best, 0)]
        seen = {root}
        queue = deque(reached)
        while queue:
            here = queue.popleft()
            for link in self._out[here.node]:
                if link.b not in seen:
                    seen.add(link.b)
                    there = Reached(link.b, link, min(here.rank, link.rank), here.depth + 1)
                    reached.append(there)
                    queue.append(there)
        return reached

    def path(self, a: int, b: int) -> tuple[Floats, Floats]:
        """T_a_b and its covariance along the tree. An upper bound: other paths are not regarded.

        Raises:
            ValueError: the nodes are in different trees.
        """
        came: dict[int, Link | None] = {a: None}
        queue = deque([a])
        while queue and b not in came:
            for link in self._out[queue[0]]:
                if link.b not in came:
                    came[link.b] = link
                    queue.append(link.b)
            queue.popleft()
        if b not in came:
            raise ValueError(f"nodes {a} and {b} are in different trees")
        T, covariance = np.eye(4), np.zeros((6, 6))
        while (link := came[b]) is not None:
            covariance = compose_covariance(link.T_a_b, link.left, covariance)
            T = link.T_a_b @ T
            b = link.a
        return T, covariance


def without_bridges(n: int, reached: list[Reached], chords: list[tuple[int, int]]) -> Sets:
    """Sets of nodes that stay joined when any one link is taken away.

    Args:
        n: number of nodes.
        reached: trees as `Forest.walk` gives them, any number of them.
        chords: links that are not part of a tree, with both ends in one tree.
    """
    parent = {r.node: r.link.a for r in reached if r.link is not None}
    depth = {r.node: r.depth for r in reached}
    sets = Sets(n)
    for a, b in chords:
        a, b = sets.find(a), sets.find(b)
        while a != b:  # the set's upmost node represents it, so this climbs
            lower = a if depth[a] >= depth[b] else b
            sets.join(parent[lower], lower)
            a, b = sets.find(a), sets.find(b)
    return sets
