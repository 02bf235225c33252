"""Which keyframes of which robots are worth aligning, and how much each pair of robots deserves the
next turn.
"""

from typing import TYPE_CHECKING

import numpy as np

from pose_server.geometry.se3 import inverse
from pose_server.pairs.schedule import pair_weight
from pose_server.views import KeptView, likeness
from protocol.keys import ordered_pair
from protocol.messages import ViewName

if TYPE_CHECKING:
    from pose_server.site import PairRecord, Robot, Site

ENOUGH_EDGES = 8  # between two joined robots; more keyframe pairs add little
_WIDE_COSINE = 0.35  # optical axes further apart than 70 deg are not worth trying


def offer_keyframe(site: "Site", view: ViewName) -> None:
    """Puts a new keyframe beside all others: of other robots, and of other segments of its own
    robot.
    """
    for other in site.keyframes():
        if other == view or other not in site.views:
            continue
        pair = ordered_pair(view.robot, other.robot)
        if pair in site.skip:
            site.pair(*pair)
            continue
        if (
            view.robot == other.robot
            and site.attached(view) is not None
            and _linked(site, view, other)
        ):
            continue
        views = (
            (view, other) if (view.robot, view.seq) < (other.robot, other.seq) else (other, view)
        )
        site.pair(*pair).untried[views] = similarity(site, view, other)


def similarity(site: "Site", a: ViewName, b: ViewName) -> float:
    """The likeness of two kept keyframes, computed once."""
    views = (a, b) if str(a) < str(b) else (b, a)
    if views not in site.similarities:
        site.similarities[views] = likeness(site.views[a], site.views[b])
    return site.similarities[views]


def candidate_views(site: "Site", robot: "Robot", view: ViewName) -> list[ViewName]:
    """The robot's keyframes that look most like a view, best first."""
    new = site.views[view]
    known = [keyframe for keyframe in robot.track.keyframes if keyframe in site.views]
    return sorted(known, key=lambda keyframe: -likeness(new, site.views[keyframe]))


def weights(site: "Site", now_s: float, joining: bool) -> dict[tuple[str, str], float]:
    """Weight of every pair of robots that has something left to try.

    Args:
        joining: only pairs that may join two components; else only those already joined.
    """
    found: dict[tuple[str, str], float] = {}
    edges = _edge_counts(site)
    for pair, record in site.pairs.items():
        if record.running or not record.untried or pair in site.skip:
            continue
        _forget_hopeless(site, pair, record, edges.get(pair, 0))
        left = [like for v, like in record.untried.items() if site.joined(*v) != joining]
        if not left:
            continue
        if record.waiting_since_s is None:
            record.waiting_since_s = now_s
        waited = now_s - record.waiting_since_s
        weight = pair_weight(waited, max(left), not joining, edges.get(pair, 0))
        found[pair] = 0.3 * weight if pair[0] == pair[1] else weight
    return found


def _edge_counts(site: "Site") -> dict[tuple[str, str], int]:
    counts: dict[tuple[str, str], int] = {}
    for edge in site.edges.values():
        pair = ordered_pair(edge.a.robot, edge.b.robot)
        counts[pair] = counts.get(pair, 0) + 1
    return counts


def _forget_hopeless(site: "Site", pair: tuple[str, str], record: "PairRecord", edges: int) -> None:
    """Drops keyframe pairs that the solution already answers, or knows to look at different
    things.
    """
    gone = []
    for views in record.untried:
        T = site.relative(*views)
        if T is None:
            continue
        if pair[0] == pair[1] or edges >= ENOUGH_EDGES or not sees_same(site, *views, T):
            gone.append(views)
    for views in gone:
        del record.untried[views]


def sees_same(site: "Site", i: ViewName, j: ViewName, T_i_j: np.ndarray) -> bool:
    """Whether two views look at a common place, by their poses and median depths."""
    if T_i_j[2, 2] < _WIDE_COSINE:
        return False
    return _centre_visible(site.views[j], site.views[i], T_i_j) or _centre_visible(
        site.views[i], site.views[j], inverse(T_i_j)
    )


def _centre_visible(source: KeptView, target: KeptView, T_target_source: np.ndarray) -> bool:
    centre = T_target_source @ np.array([0.0, 0.0, source.median_depth_m, 1.0])
    if centre[2] <= 0:
        return False
    u, v, w = target.camera.K @ centre[:3]
    margin = 0.25 * target.camera.width
    return (
        -margin < u / w < target.camera.width + margin
        and -margin < v / w < target.camera.height + margin
    )


def _linked(site: "Site", a: ViewName, b: ViewName) -> bool:
    return (a, b, "odometry") in site.edges or (b, a, "odometry") in site.edges
