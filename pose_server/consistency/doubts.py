"""Witnesses that disagree: a robot's pixels, its odometry, its own map, its camera's word.

Where two of them contradict each other nothing tells which one is right. The robot is then not
located until they agree again, and why is said in words: as an event at once, as an alarm while it
lasts.
"""

import logging
from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose, moved
from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.se3 import (
    compose_covariance,
    inverse,
    invert_covariance,
    log_so3,
    rotation_angle,
)
from fleetpose.pose_server.state.doubts import Doubt, Kind, Standstill
from fleetpose.pose_server.state.odometry import Moment, camera_motion
from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.messages import Alarm, ViewName

log = logging.getLogger("pose_server")

Floats = npt.NDArray[np.floating]

DROVE = 0.15  # of `moved`: 1.8 % of the depth, or 1.7 deg; what odometry does at rest is less
_STILL, _STILL_SHARE = 0.1, 0.2  # of `moved`, and of what odometry says: what images show at most
_OVER_S = 10.0  # slow driving adds up for so long; the drift of an hour must not
_CONFIRMED_S = 0.9  # a robot that sets off is seen to move later than its odometry says
_CHANCE = 1e-3


def why_doubted(site: Site, robot: Robot) -> str:
    """Why a robot's newest pose must not be believed; empty if nothing speaks against it."""
    doubt = site.doubts.standing.get(robot.name)
    if doubt is not None:
        return doubt.text
    newest = robot.track.newest
    if newest is not None and robot.epoch is not None and newest.view.epoch != robot.epoch:
        return "it was started anew, and none of its views since then is aligned yet"
    return ""


def doubt_alarms(site: Site) -> tuple[Alarm, ...]:
    """An alarm for every doubt about a robot that is there."""
    return tuple(
        Alarm(robot=name, kind=doubt.kind, text=doubt.text)
        for name, doubt in sorted(site.doubts.standing.items())
        if name in site.robots and site.robots[name].alive
    )


def camera_frozen(site: Site, robot: Robot, view: KeptView) -> bool:
    """Whether a robot says of a view that its camera gives the same image again and again: what it
    shows is of the past.
    """
    if not view.frozen_s:
        _believe(site, robot.name, ("frozen",), "gives new images again")
        return False
    text = (
        f"the camera of {robot.name} is frozen: its images are identical to the last bit, and no "
        "sensor gives two such; check its driver and its cable"
    )
    _doubt(site, robot, Doubt("frozen", text, view.name))
    return True


def wheels_disagree(site: Site, robot: Robot, here: KeyframeRelativePose) -> bool:
    """Whether a view hangs where pixels stood still while the robot's odometry drove on: then one
    of both is wrong. Said when a second view shows it as well.

    Args:
        here: the robot's newest view, where its pixels put it.
    """
    kept, stood = site.views[here.view], site.doubts.standstills.get(robot.name)
    moment = site.odometers.at(here.view, kept.stamp_ns)
    if stood is None:
        before = None if moment is None else _a_while_before(site, robot, here)
        if before is None or not _contradict(kept, before, here, moment):
            return False
        site.doubts.stop(robot.name, Standstill(*before, kept.received_s))
        return True
    if stood.at.view.epoch != here.view.epoch:
        moment = None  # odometry of another life has another frame
    if _is_over(site, stood, here, moment):
        site.doubts.move(robot.name)
        _believe(site, robot.name, ("still",), "is seen to move as its odometry says")
        return False
    if moment is not None and kept.received_s - stood.since_s >= _CONFIRMED_S:
        text = _still_text(robot.name, stood.moment, moment)
        _doubt(site, robot, Doubt("still", text, here.view))
    return True


def note_lost(site: Site, robot: Robot, view: ViewName) -> None:
    """A robot's view aligns with none of its keyframes, and no odometry leads there."""
    known = site.doubts.standing.get(robot.name)
    if known is not None and known.kind in ("lost", "carried"):
        return  # it is still where nothing is known
    lived = any(one.epoch == view.epoch and one != view for one in robot.track.attached)
    what = (
        f"{robot.name} lost track of itself: it sees nothing it saw before, from its view "
        f"{view.seq} on: carried or covered?"
        if lived
        else f"{robot.name} was started anew and sees nothing it saw before: carried while it was "
        "off? Where it was counts no more."
    )
    until = "it, or another robot, knows the place, or clicks join it"
    text = f"{what} It is not located until {until}"
    _doubt(site, robot, Doubt("lost" if lived else "carried", text, view))


def reconsider(site: Site) -> None:
    """Robots that were lost are found again where they are joined to more than what they saw since
    then.
    """
    for name, doubt in list(site.doubts.standing.items()):
        robot = site.robots.get(name)
        if robot is None or doubt.kind not in ("lost", "carried"):
            continue
        keyframes, newest = robot.track.keyframes, robot.track.newest
        since = keyframes.index(doubt.since) if doubt.since in keyframes else 0
        strange = set(keyframes[since:])
        if newest is None or site.solution is None or newest.keyframe not in site.solution.nodes:
            continue
        root = site.solution.nodes[newest.keyframe].root
        if not strange.issuperset(site.solution.components[root]):
            _believe(site, name, ("lost", "carried"), "sees something known again")


def _doubt(site: Site, robot: Robot, doubt: Doubt) -> None:
    if not site.doubts.doubt(robot.name, doubt):
        return
    site.touch(robot.name)  # its pose is told anew, as one that is not located
    site.say(doubt.text)
    log.warning("alarm robot=%s kind=%s text=%s", robot.name, doubt.kind, doubt.text)


def _believe(site: Site, name: str, kinds: Collection[Kind], why: str) -> None:
    """Ends a doubt of one of these kinds, if there is one."""
    if site.doubts.believe(name, kinds):
        site.touch(name)
        site.say(f"{name} {why}")


def _is_over(
    site: Site, stood: Standstill, here: KeyframeRelativePose, moment: Moment | None
) -> bool:
    """Whether pixels and odometry agree again, or too little was heard to say that they do not."""
    kept = site.views[here.view]
    if _shown(stood.at, here, kept.median_depth_m) > _STILL:
        return True
    if moment is None:
        return here.view.robot not in site.doubts.standing
    return not _contradict(kept, (stood.at, stood.moment), here, moment)


def _a_while_before(
    site: Site, robot: Robot, here: KeyframeRelativePose
) -> tuple[KeyframeRelativePose, Moment] | None:
    """The oldest of the robot's views of the last seconds that hangs on the same keyframe."""
    now_s = site.views[here.view].received_s
    found: list[tuple[float, KeyframeRelativePose, Moment]] = []
    for other in robot.track.attached.values():
        kept = site.views.get(other.view)
        if kept is None or other.keyframe != here.keyframe or other.view.epoch != here.view.epoch:
            continue
        moment = site.odometers.at(other.view, kept.stamp_ns)
        if moment is not None and other.view != here.view and now_s - kept.received_s < _OVER_S:
            found.append((kept.received_s, other, moment))
    return min(found, key=lambda one: one[0])[1:] if found else None


def _contradict(
    kept: KeptView,
    before: tuple[KeyframeRelativePose, Moment],
    here: KeyframeRelativePose,
    moment: Moment | None,
) -> bool:
    """Whether odometry says that the robot drove, beyond its sigma, and pixels that it stood."""
    if moment is None:
        return False
    at, moment_before = before
    depth_m = kept.median_depth_m
    T_robot_camera = kept.camera.T_robot_camera
    T, covariance = camera_motion(moment_before, moment, T_robot_camera, T_robot_camera)
    driven, shown = moved(T, depth_m), _shown(at, here, depth_m)
    if driven < DROVE or shown > min(_STILL, _STILL_SHARE * driven):
        return False
    T_seen, C_seen = _between(at, here)
    off = inverse(T_seen) @ T
    xi = np.concatenate((log_so3(off[:3, :3]), off[:3, 3]))
    return float(xi @ np.linalg.solve(covariance + C_seen, xi)) > chi2_limit(_CHANCE, 6)


def _between(a: KeyframeRelativePose, b: KeyframeRelativePose) -> tuple[Floats, Floats]:
    """T_a_b of two views on one keyframe, and its covariance."""
    back = inverse(a.T_keyframe_view)
    T = back @ b.T_keyframe_view
    C_back = invert_covariance(a.T_keyframe_view, a.covariance)
    return T, compose_covariance(back, C_back, b.covariance)


def _shown(a: KeyframeRelativePose, b: KeyframeRelativePose, depth_m: float) -> float:
    """How far the robot moved between two views by its pixels, 1 at the border of `far`."""
    if a.keyframe != b.keyframe:
        return np.inf
    return moved(_between(a, b)[0], depth_m)


def _still_text(name: str, before: Moment, now: Moment) -> str:
    T = inverse(before.T_odom_robot) @ now.T_odom_robot
    shift, turn = float(np.linalg.norm(T[:3, 3])), np.degrees(rotation_angle(T[:3, :3]))
    return (
        f"the pixels of {name} stand still while its odometry drove {shift:.1f} m and turned "
        f"{turn:.0f} deg: its camera is frozen or sees only what moves with it, or its wheels "
        "slip; where it is is not known until its images move"
    )
