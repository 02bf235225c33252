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

A place that is symmetric as a whole passes the first test and not the second: each of its pairs is
known to be as likely an alias as not, and however many of these agree, they remain so.
"""

import heapq
import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from itertools import combinations

from pose_server.fleet.links import Link
from pose_server.geometry.structure import Structure

_NEVER = 1e-9  # no link is surer


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


def along_surest_ways(roots: Iterable[int], links: Iterable[Link]) -> dict[int, float]:
    """Per node that links lead to: the probability that any link of the surest way there from a
    root is gravely off (Dijkstra). What other ways confirm is not counted: they may be copies.
    """
    neighbours: dict[int, list[tuple[int, float]]] = defaultdict(list)
    for link in links:
        cost = -math.log1p(-min(max(link.p_grave, _NEVER), 1.0 - _NEVER))
        neighbours[link.a].append((link.b, cost))
        neighbours[link.b].append((link.a, cost))
    found: dict[int, float] = {}
    queue = [(0.0, root) for root in roots]
    heapq.heapify(queue)
    while queue:
        cost, node = heapq.heappop(queue)
        if node not in found:
            found[node] = cost
            for other, more in neighbours[node]:
                heapq.heappush(queue, (cost + more, other))
    return {node: -math.expm1(-cost) for node, cost in found.items()}
