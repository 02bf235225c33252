"""What edges of one view have in common: the errors of the points that they rest on.

Half of an edge's variance is the one view's, half the other's. Two edges of a view that rest on the
same of its points have that half in common, so that many of them say little more than one. Edges
that rest on different parts of what it sees have not.
"""

from collections import defaultdict
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.pose_graph.links import Link

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

_UNKNOWN = 0.5  # overlap of structures of which one is not known
_BLUR = 0.1  # of a structure's whole variance, to each side: depth noise must not tell planes apart


def inflations(links: Sequence[Link], poses: Sequence[Floats], share: float) -> Floats:
    """(L,) by what the covariance of each link is to be multiplied, so that all of them together
    are as sure as they may be.

    Args:
        links: that are used.
        poses: (4, 4) T_root_node per node.
        share: of an edge's variance that it has in common with another edge of its view on the
            very same points.
    """
    out = np.ones(len(links))
    placed = [
        None if link.structure is None else link.structure.seen_from(poses[link.a])
        for link in links
    ]
    centres = np.stack([np.full(3, np.nan) if p is None else p.centre for p in placed])
    spreads = np.stack([np.eye(3) if p is None else p.spread for p in placed])
    at: dict[int, list[int]] = defaultdict(list)
    for k, link in enumerate(links):
        at[link.a].append(k)
        at[link.b].append(k)
    both = [pair for numbers in at.values() for pair in combinations(numbers, 2)]
    if both:
        first, second = np.array(both, np.int64).T
        common = overlaps(centres, spreads, first, second)
        for number in (first, second):
            np.add.at(out, number, 0.5 * share * common)
    return out


def overlaps(centres: Floats, spreads: Floats, first: Indices, second: Indices) -> Floats:
    """(M,) how much point sets overlap, 0 to 1: the Bhattacharyya coefficient of the blurred normal
    distributions.

    Args:
        centres, spreads: their middles (N, 3) and covariances (N, 3, 3).
        first, second: (M,) which are compared.
    """
    blurred = spreads + _BLUR * np.trace(spreads, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    mean = 0.5 * (blurred[first] + blurred[second])
    apart = centres[first] - centres[second]
    known = np.isfinite(apart.sum(axis=1))
    apart = np.where(known[:, None], apart, 0.0)
    distance = np.einsum("mi,mi->m", apart, np.linalg.solve(mean, apart[..., None])[..., 0])
    logs = np.linalg.slogdet(blurred)[1]
    spread = np.linalg.slogdet(mean)[1] - 0.5 * (logs[first] + logs[second])
    return np.where(known, np.exp(-0.125 * distance - 0.5 * spread), _UNKNOWN)
