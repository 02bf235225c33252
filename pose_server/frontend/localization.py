"""Following robots through their own views, on their keyframes: the newest view of each as it
comes, and older ones that an operator looks at.
"""

from collections import Counter

import numpy as np

from fleetpose.pose_server.calibration.monitor import note_motion, note_time_offset
from fleetpose.pose_server.consistency.blindness import note_blind
from fleetpose.pose_server.consistency.doubts import (
    DROVE,
    camera_frozen,
    note_lost,
    reconsider,
    wheels_disagree,
)
from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose, accepted, moved, standing
from fleetpose.pose_server.frontend.trajectory import Followed, most_followed
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling.pair_queue import note_keyframe, try_again
from fleetpose.pose_server.scheduling.proposals import candidate_views
from fleetpose.pose_server.scheduling.retries import note_stand
from fleetpose.pose_server.state.odometry import camera_motion
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import STILL_PX, KeptView, something_moved, stands_still
from fleetpose.pose_server.workers.jobs import Done, Job, TrackJob
from fleetpose.protocol.messages import ViewName

MOST_KEYFRAMES, LEAST_KEYFRAMES = 40, 6  # of a robot, in a small and in a large fleet
MOST_BLIND = 5  # keyframes in a row that hang by odometry alone
_ODOMETRY_SIGMA = 0.02  # how far a start by odometry may be off, share of the depth
FLEET_KEYFRAMES = 500  # of all robots together: what a solve in a fraction of a second allows


def newest_arrived(site: Site, robot: Robot, view: KeptView) -> None:
    """The newest view of a robot waits to be followed; where no pixel moved, or before the first
    keyframe, no worker is needed.
    """
    robot.arrive(view.name)
    note_stand(robot, view)
    site.odometers.at(view.name, view.stamp_ns)
    note_blind(site, robot, view)
    if camera_frozen(site, robot, view):
        robot.wait(None)
    elif not robot.track.keyframes:
        robot.wait(None)
        new_keyframe(site, robot, view.name)
    elif _stayed(site, robot, view, robot.track.reference or robot.track.keyframe_near(view.name)):
        robot.wait(None)
        try_again(site, robot, view.received_s)


def localize_past(site: Site, view: ViewName) -> None:
    """Asks for a kept view, newest or not, to be hung on a keyframe, because an operator looks at
    it or clicked in it.
    """
    robot = site.robots.get(view.robot)
    if robot is None:
        return
    on_its_way = (
        view in (robot.waiting, robot.tracking, robot.past_in_flight) or view in robot.past_queue
    )
    if view in site.views and site.attached(view) is None and not on_its_way:
        robot.want_past(view)


def back_job(site: Site) -> Job | None:
    """The next older view that somebody looks at."""
    for robot in site.robots.values():
        while (view := robot.next_past()) is not None:
            if view not in site.views or site.attached(view) is not None:
                continue
            robot.track.recall_past(view)
            near = robot.track.keyframe_near(view)
            if _stayed(site, robot, site.views[view], near):
                _placed(site, view)
            elif (job := _follow(site, robot, view)) is not None:
                return job
    return None


def track_job(site: Site) -> Job | None:
    """The newest view of the robot that lags most."""
    waiting = [robot for robot in site.robots.values() if robot.waiting and robot.tracking is None]
    if not waiting:
        return None
    robot = min(waiting, key=lambda r: _followed_s(site, r))
    view = robot.waiting
    assert view is not None
    robot.wait(None)
    return _follow(site, robot, view)


def followed(site: Site, done: Done) -> None:
    """Files an alignment of a view with a keyframe of its own robot."""
    view, keyframe = done.job.j.name, done.job.i.name
    robot = site.robot(view.robot)
    past = view in robot.track.past
    robot.followed(view)
    if view not in site.views or keyframe not in site.views:
        return
    step = "try"
    if done.result is not None:
        robot.track.mask(dict(zip((keyframe, view), done.result.moving, strict=True)))
        note_motion(site, view, done.result.moving[1])
        note_time_offset(site, done)
        if not past and _is_refuted(site, robot, view, keyframe, done.result):
            return
        depth = site.views[view].median_depth_m
        nearer = None if past else _nearer_keyframe(site, robot, keyframe, done.result, depth)
        step = robot.track.take(view, keyframe, done.result, depth, nearer)
    if step == "try":
        _try_again(site, robot, view, past)
        return
    if step == "keyframe":
        new_keyframe(site, robot, view)
    else:
        _note_followed(site, robot, view)
        _ask_for_covariance(site, robot.track.attached[view].keyframe)
    if past:
        _placed(site, view)
    elif step == "attached":
        try_again(site, robot, site.views[view].received_s)
    reconsider(site)


def new_keyframe(site: Site, robot: Robot, view: ViewName) -> None:
    """Makes a view a keyframe, links it to the one it was aligned with, and offers it to the other
    robots.
    """
    link = robot.track.link_of(view)
    robot.track.begin(view)
    _note_followed(site, robot, view)
    if link is not None:
        # in another life the robot did not come from there by what it did: it was recognised
        kind = "odometry" if link.keyframe.epoch == view.epoch else "pair"
        T, covariance = link.T_keyframe_view, link.covariance
        site.link(Edge(link.keyframe, view, T, covariance, link.verdict, kind))
    note_keyframe(site, view)
    site.want_solution()
    share = FLEET_KEYFRAMES // max(len(site.robots), 1)
    if len(robot.track.keyframes) > min(max(share, LEAST_KEYFRAMES), MOST_KEYFRAMES):
        _drop_keyframe(site, robot)


def _try_again(site: Site, robot: Robot, view: ViewName, past: bool) -> None:
    if past:
        robot.want_past(view, first=True)
    elif robot.waiting is None:
        robot.wait(view)
    else:
        site.count("views_overtaken")
        if view in site.correspondences.views():
            localize_past(site, view)


def _followed_s(site: Site, robot: Robot) -> float:
    """When the newest view that hangs somewhere was received: who lags most is next."""
    newest = robot.track.newest
    kept = None if newest is None else site.views.get(newest.view)
    return -np.inf if kept is None else kept.received_s


def _follow(site: Site, robot: Robot, view: ViewName) -> Job | None:
    """The next try to hang a view on one of its robot's keyframes."""
    past = view in robot.track.past
    keyframe = robot.track.next_try(view, lambda: candidate_views(site, robot, view))
    if keyframe is None or keyframe not in site.views:
        if not past and (here := _by_odometry(site, robot, view)) is not None:
            robot.track.dead_reckon(here)
            new_keyframe(site, robot, view)
            return None
        if robot.track.give_up(view) == "segment":
            if past:
                site.say(f"{robot.name}'s view {view.seq} hangs on none of its keyframes")
            else:
                note_lost(site, robot, view)
        new_keyframe(site, robot, view)
        if past:
            _placed(site, view)
        return None
    starts: tuple[Start, ...] = ()
    robot.follow(view)
    newest = robot.track.newest
    if not past and newest is not None and newest.keyframe == keyframe:
        starts = (Start("previous", newest.T_keyframe_view, 0.03),)
    here = _moved_by_odometry(site, keyframe, view)
    if here is not None:
        starts = (Start("previous", here.T_keyframe_view, _ODOMETRY_SIGMA),)
    return TrackJob(site.views[keyframe].encoded, site.views[view].encoded, starts)


def _by_odometry(site: Site, robot: Robot, view: ViewName) -> KeyframeRelativePose | None:
    """Where a view that aligns with nothing hangs by its robot's own odometry, for a few views in a
    row: a robot that was carried away does not know. One that did not drive would still see what it
    saw: its pixels contradict its wheels.
    """
    newest = robot.track.newest
    if newest is None or robot.track.blind >= MOST_BLIND or newest.keyframe not in site.views:
        return None
    since = _moved_by_odometry(site, newest.view, view) if newest.view in site.views else None
    if since is not None and moved(since.T_keyframe_view, site.views[view].median_depth_m) < DROVE:
        return None
    return _moved_by_odometry(site, newest.keyframe, view)


def _is_refuted(
    site: Site, robot: Robot, view: ViewName, keyframe: ViewName, result: PairResult
) -> bool:
    """Whether a robot's odometry contradicts where an alignment hangs its newest view."""
    if not accepted(result):
        return False
    assert result.T_i_j is not None and result.covariance is not None
    here = KeyframeRelativePose(view, keyframe, result.T_i_j, result.covariance, result.verdict)
    return wheels_disagree(site, robot, here)


def _moved_by_odometry(
    site: Site, keyframe: ViewName, view: ViewName
) -> KeyframeRelativePose | None:
    """T_keyframe_view of the cameras by what the robot says of its own motion, if it does."""
    before, now = site.views[keyframe], site.views[view]
    a = site.odometers.at(keyframe, before.stamp_ns)
    b = site.odometers.at(view, now.stamp_ns)
    if a is None or b is None or keyframe.epoch != view.epoch:
        return None
    T, covariance = camera_motion(a, b, before.camera.T_robot_camera, now.camera.T_robot_camera)
    return KeyframeRelativePose(view, keyframe, T, covariance, "plausible")


def _stayed(site: Site, robot: Robot, view: KeptView, keyframe: ViewName | None) -> bool:
    """Hangs a view on a keyframe without a worker where no pixel moved; what walks past a robot
    that stands still takes a worker to be masked.
    """
    if keyframe is None or keyframe not in site.views:
        return False
    before = site.views[keyframe]
    if not stands_still(before, view) or something_moved(before, view):
        return False
    sigma_rad = STILL_PX / float(view.camera.K[0, 0])
    here = standing(view.name, keyframe, sigma_rad, sigma_rad * view.median_depth_m)
    if view.name not in robot.track.past and wheels_disagree(site, robot, here):
        return True  # it waits for nothing, and hangs nowhere
    robot.track.hang(here)
    _note_followed(site, robot, view.name)
    _ask_for_covariance(site, keyframe)
    return True


def _note_followed(site: Site, robot: Robot, view: ViewName) -> None:
    """Where a view hangs is known longer than the view is kept."""
    here = robot.track.attached[view]
    way, stamp_ns = (here.T_keyframe_view, here.covariance), site.views[view].stamp_ns
    followed = Followed(view, stamp_ns, here.keyframe, *way, here.verdict)
    robot.track.trajectory.note(followed, most_followed(len(site.robots)))


def _ask_for_covariance(site: Site, keyframe: ViewName) -> None:
    """The next solve makes the covariance of a keyframe on which a robot has just come to hang."""
    if site.solution is not None:
        node = site.solution.nodes.get(keyframe)
        if node is None or node.covariance is None:
            site.want_solution()


def _placed(site: Site, view: ViewName) -> None:
    """An older view hangs somewhere now: clicks that were made in it begin to count."""
    site.robot(view.robot).track.place_past(view)
    for kept in site.correspondences.all():
        if view in (kept.item.view_i, kept.item.view_j):
            site.pair(kept.item.view_i.robot, kept.item.view_j.robot).make_due("clicks")
            site.want_solution()


def _nearer_keyframe(
    site: Site, robot: Robot, keyframe: ViewName, result: PairResult, depth_m: float
) -> ViewName | None:
    """Another keyframe of the robot that a view is near to, judged by the solution."""
    if not accepted(result) or result.T_i_j is None:
        return None
    near: list[tuple[float, ViewName]] = []
    for other in robot.track.keyframes:
        T = None if other == keyframe else site.relative(other, keyframe)
        if T is not None:
            near.append((moved(T @ result.T_i_j, depth_m), other))
    distance, other = min(near, default=(np.inf, None), key=lambda pair: pair[0])
    return other if distance < 0.8 else None


def _drop_keyframe(site: Site, robot: Robot) -> None:
    """Forgets the oldest keyframe that nothing important hangs on."""
    clicked = {site.attached(view) for view in site.correspondences.views()}
    kept = {here.keyframe for here in clicked if here is not None}
    kept |= {site.gauge, robot.track.reference, *site.anchoring.origins}
    oldest = next((view for view in _spare(site, robot) if view not in kept), None)
    if oldest is None:
        return
    _hang_elsewhere(site, robot, oldest)
    robot.track.forget({oldest})
    site.forget_keyframe(oldest)


def _hang_elsewhere(site: Site, robot: Robot, keyframe: ViewName) -> None:
    """What hung on a keyframe that goes hangs on the nearest one that stays."""
    near = [
        (moved(T, site.views[keyframe].median_depth_m), other, T)
        for other in robot.track.keyframes
        if other != keyframe and (T := site.relative(other, keyframe)) is not None
    ]
    if not near:
        robot.track.trajectory.forget(keyframe)
        return
    _, other, T = min(near, key=lambda one: one[0])
    uncertainty = None if site.solution is None else site.solution.uncertainty
    covariance = None if uncertainty is None else uncertainty.relative(other, keyframe)
    if covariance is None:
        covariance = np.full((6, 6), np.nan)
    robot.track.trajectory.rehang(keyframe, other, T, covariance)


def _spare(site: Site, robot: Robot) -> list[ViewName]:
    """A robot's keyframes, those first that can be spared most: what hangs on nothing, as seen by a
    covered camera; then of the component that has most of them, since a map of where the robot was
    before is not forgotten for one of where it is.
    """
    nodes = {} if site.solution is None else site.solution.nodes
    keyframes = robot.track.keyframes
    roots = {view: nodes[view].root for view in keyframes if view in nodes}
    own, anybodys = Counter(roots.values()), Counter(node.root for node in nodes.values())

    def worth(view: ViewName) -> tuple[bool, int]:
        root = roots.get(view, view)
        return anybodys[root] != 1, -own[root]

    return sorted(keyframes, key=worth)
