"""A pair whose last alignment failed is tried again once either robot's view really changed.

A robot that moves far makes a keyframe, which the pair queue lays beside all others. One that moves
less makes none, and neither does one before which something was put away: both may see now what
they did not see before. A robot that stands and sees what it saw is not asked again: the answer
would be the same.
"""

from fleetpose.pose_server.scheduling.proposals import (
    ENOUGH_EDGES,
    LEAST_OVERLAP,
    expected_overlaps,
)
from fleetpose.pose_server.state.pairs import PairRecord
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView, likeness, something_moved, stands_still
from fleetpose.protocol.keys import RobotPair, ordered_pair
from fleetpose.protocol.messages import ViewName

_MOST_DOUBLINGS = 20  # of the rest between two tries: months


def note_stand(robot: Robot, view: KeptView) -> None:
    """Notes since which view a robot stands and sees the same."""
    stood = robot.stood
    if stood is None or not stands_still(stood, view) or something_moved(stood, view):
        robot.stand_since(view)


def retries_due(site: Site, robot: Robot, now_s: float) -> list[RobotPair]:
    """Lays a robot's newest view that hangs somewhere beside those of the robots with which its
    last alignment failed, where they have rested and one of both changed; the pairs.
    """
    due = []
    for other in site.partners[robot.name]:
        pair = ordered_pair(robot.name, other)
        record = site.pairs[pair]
        if pair in site.skip or not _has_rested(site, record, now_s):
            continue
        views = _newest_views(site, pair)
        if views is None or _was_tried(site, record, views):
            continue
        promise = _promise(site, *views)
        if promise is not None:
            record.propose_again(views, promise)
            due.append(pair)
    return due


def _has_rested(site: Site, record: PairRecord, now_s: float) -> bool:
    if record.failures == 0 or record.running or record.clicks_due:
        return False
    rest_s = site.weights.retry_s * 2.0 ** min(record.failures - 1, _MOST_DOUBLINGS)
    return now_s - record.last_s >= rest_s


def _newest_views(site: Site, pair: RobotPair) -> tuple[ViewName, ViewName] | None:
    """The newest view of each that hangs on a keyframe, if both are kept."""
    newest = [site.robots[name].track.newest for name in pair if name in site.robots]
    views = [here.view for here in newest if here is not None and here.view in site.views]
    return (views[0], views[1]) if len(views) == 2 else None


def _was_tried(site: Site, record: PairRecord, views: tuple[ViewName, ViewName]) -> bool:
    """Whether views that show the same as these were aligned already."""
    before = [*record.tried, *([] if record.last_views is None else [record.last_views])]
    return any(
        all(
            any(_shows_the_same(site, old, new) for old in tried if old.robot == new.robot)
            for new in views
        )
        for tried in before
    )


def _shows_the_same(site: Site, old: ViewName, new: ViewName) -> bool:
    """Whether a robot has stood still, and seen the same, from one of its views to a newer one."""
    stood = site.robots[new.robot].stood
    if stood is None or old.epoch != new.epoch:
        return False
    return old == new or min(old.seq, new.seq) >= stood.name.seq


def _promise(site: Site, a: ViewName, b: ViewName) -> float | None:
    """What two views promise, as for keyframes; none where they are not worth an alignment, or hang
    on a keyframe that no solution knows yet.
    """
    at_a, at_b = site.attached(a), site.attached(b)
    if site.solution is None or at_a is None or at_b is None:
        return None
    keyframes = (at_a.keyframe, at_b.keyframe)
    if not all(view in site.solution.nodes and view in site.views for view in keyframes):
        return None
    if not site.joined(a, b):
        return likeness(site.views[a], site.views[b])
    if site.edge_count(a.robot, b.robot) >= ENOUGH_EDGES:
        return None
    overlap = float(expected_overlaps(site, at_a.keyframe, [at_b.keyframe])[0])
    return overlap if overlap >= LEAST_OVERLAP else None
