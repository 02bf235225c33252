"""When two witnesses are better than one: independent ones, and what agreement is worth.

Plausible edges of a place that repeats itself agree with each other although all are wrong: two
views of one wing are both laid over the other wing, by the same turn. So two plausible edges count
as two witnesses only if

- they rest on different structure: where their matches are in the world, told in one frame, does
  not overlap. An edge A - B and an edge A' - B' whose views see the same matched points say the
  same thing twice, whatever their noise. What an edge rests on must be known.
- nothing in their probabilities contradicts it. Agreement is not taken for a proof: aliases of one
  place are taken to agree always (a courtyard with two alike wings has one way only to be wrong),
  so that n edges that agree are either all right or wrong together.

A link that alone joins two parts is sure only as far as the others between them agree with it.
Views of two alike halls make links that say the same, each with its own chance: one that is sure by
luck among many that doubt is no better than all of them on the average, for all are right or wrong.

A place that is symmetric as a whole passes the first test and not the second: each of its pairs is
known to be as likely an alias as not, and however many of these agree, they remain so.
"""

import heapq
import math
from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph.links import Link
from fleetpose.pose_server.pose_graph.types import GRAVE_ODOMETRY

Floats = npt.NDArray[np.floating]
Structures = tuple[Floats, Floats]

_NEVER = 1e-9  # no link is surer
_SURE, _MOST_CONFIRMED = 0.005, 16  # links below it need no confirmation; so many are looked at
_POOR = 0.2  # a link that is likelier wrong speaks against those that say the same
_MOST_TOLD = 7.0  # log odds, at most, that one link has a say with


def independent(structures: Sequence[Structure | None]) -> bool:
    """Whether all rest on different structure; they are given in one frame."""
    known = [one for one in structures if one is not None]
    return len(known) == len(structures) and all(a.apart(b) for a, b in combinations(known, 2))


def all_grave(p_grave: Sequence[float]) -> float:
    """Probability that all links between two parts are gravely off, given that they agree: Bayes,
    with aliases that always agree.
    """
    wrong, right = math.prod(p_grave), math.prod(1.0 - p for p in p_grave)
    return wrong / (wrong + right) if wrong + right > 0.0 else 1.0


def some_grave(p_grave: Sequence[float]) -> float:
    """Probability that any link of a cycle is gravely off, given that it closes: one alone cannot
    be, two or more are taken to make up for each other.
    """
    right = math.prod(1.0 - p for p in p_grave)
    one = sum(
        p * math.prod(1.0 - q for m, q in enumerate(p_grave) if m != k)
        for k, p in enumerate(p_grave)
    )
    return 1.0 - right / (1.0 - one) if one < 1.0 else 1.0


def along_surest_ways(
    roots: Sequence[int], links: Sequence[Link], poses: Sequence[Floats]
) -> dict[int, float]:
    """Per node that links lead to: the probability that any link of the surest way there from a
    root is gravely off (Dijkstra), after each doubtful link on these ways was confirmed as far as
    independent others lead from its one end to its other one.

    Args:
        roots: one node per component.
        links: that are used; the solution agrees with all of them.
        poses: (4, 4) T_root_node per node.
    """
    p_grave = [link.p_grave for link in links]
    _, taken = _surest(roots, links, p_grave)
    _doubt_lone_joins(links, taken, p_grave)
    _, taken = _surest(roots, links, p_grave)
    doubtful = sorted((k for k, _ in taken if p_grave[k] > _SURE), key=lambda k: -p_grave[k])
    if doubtful:
        _confirm(links, poses, doubtful[:_MOST_CONFIRMED], p_grave)
    costs, _ = _surest(roots, links, p_grave)
    return {node: -math.expm1(-cost) for node, cost in costs.items()}


def _doubt_lone_joins(
    links: Sequence[Link], taken: Sequence[tuple[int, int]], p_grave: list[float]
) -> None:
    """Raises the probabilities of links that alone join two parts to what all links between these
    parts say on the average; they agree, since all are used.

    Args:
        links: all of them.
        taken: the links of a tree, root first, each with the node that it leads to.
        p_grave: of the links.
    """
    a, b = np.array([(link.a, link.b) for link in links], np.int64).reshape(-1, 2).T
    chance = np.array(p_grave)
    odds = np.clip(np.log(chance + _NEVER) - np.log1p(_NEVER - chance), -_MOST_TOLD, _MOST_TOLD)
    count = 1 + max((max(link.a, link.b) for link in links), default=0)
    beyond = np.eye(count, dtype=bool)  # each node with all that hang on it
    for k, node in reversed(taken):
        beyond[links[k].a + links[k].b - node] |= beyond[node]
        if links[k].structure is None:
            continue  # a robot's own motion, or nothing is known of it
        across = beyond[node][a] != beyond[node][b]
        across[k] = False
        if not across.any() or chance[across].min() < _POOR:
            continue
        across[k] = True
        p_grave[k] = max(p_grave[k], float(1.0 / (1.0 + np.exp(-odds[across].mean()))))


def _confirm(
    links: Sequence[Link], poses: Sequence[Floats], doubtful: Sequence[int], p_grave: list[float]
) -> None:
    """Lowers the probabilities of doubtful links by other ways from end to end that are independent
    of them and agree, as both are used.
    """
    at = _structures(links, poses)
    for k in doubtful:
        others = np.nonzero(_confirming(links, at, k))[0].tolist()
        ways = [links[m] for m in others]
        costs, _ = _surest([links[k].a], ways, [one.p_grave for one in ways])
        if links[k].b in costs:
            other_way = -math.expm1(-costs[links[k].b])
            p_grave[k] = min(p_grave[k], all_grave([p_grave[k], other_way]))


def _structures(links: Sequence[Link], poses: Sequence[Floats]) -> Structures:
    """What links rest on: its middles (N, 3) and spreads (N, 3, 3) in the root's frame; nan where
    that is not known.
    """
    nowhere = Structure(np.full(3, np.nan), np.eye(3))
    placed = [
        nowhere if link.structure is None else link.structure.seen_from(poses[link.a])
        for link in links
    ]
    return np.stack([one.centre for one in placed]), np.stack([one.spread for one in placed])


def _confirming(links: Sequence[Link], at: Structures, k: int) -> npt.NDArray[np.bool_]:
    """(N,) which links may be on a way that confirms another one: they rest on other structure, or
    are a robot's own motion, which rests on none.
    """
    apart = Structure(at[0][k], at[1][k]).apart_from(*at)
    own_motion = [link.structure is None and link.p_grave <= GRAVE_ODOMETRY for link in links]
    confirming = apart | np.array(own_motion)
    confirming[k] = False
    return confirming


def _surest(
    roots: Sequence[int], links: Sequence[Link], p_grave: Sequence[float]
) -> tuple[dict[int, float], list[tuple[int, int]]]:
    """The cost -log(1 - p) of the surest way to each node, and the numbers of the links on these
    ways with the nodes that they lead to, the nearest first.
    """
    neighbours: dict[int, list[tuple[int, float, int]]] = defaultdict(list)
    for k, link in enumerate(links):
        cost = -math.log1p(-min(max(p_grave[k], _NEVER), 1.0 - _NEVER))
        neighbours[link.a].append((link.b, cost, k))
        neighbours[link.b].append((link.a, cost, k))
    found: dict[int, float] = {}
    taken: list[tuple[int, int]] = []
    queue = [(0.0, root, -1) for root in roots]
    heapq.heapify(queue)
    while queue:
        cost, node, by = heapq.heappop(queue)
        if node in found:
            continue
        found[node] = cost
        if by >= 0:
            taken.append((by, node))
        for other, more, k in neighbours[node]:
            heapq.heappush(queue, (cost + more, other, k))
    return found, taken
