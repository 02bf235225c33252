"""Robots that see hardly anything that has depth: named, and nobody is asked about them."""

import logging

from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.messages import Alarm

log = logging.getLogger("pose_server")

LEAST_POINTS = 30
"""Points with depth: with fewer, of which some are wrong and few are shared, an alignment has
hardly the dozen inliers that it needs, and an operator hardly anything to click at."""
_LEFT = 0.1  # of what the robot's own keyframes have


def note_blind(site: Site, robot: Robot, view: KeptView) -> None:
    """Notes whether a robot's newest view has hardly any depth; that it begins or ends is an
    event.
    """
    kept = [
        site.views[keyframe]
        for keyframe in robot.track.keyframes
        if keyframe in site.views and keyframe != view.name
    ]
    usual = max((one.depth_points for one in kept), default=0)
    glance = max((one.glance_points for one in kept), default=0)
    points, had = view.depth_points, usual
    if view.glance_points < _LEFT * glance:  # specks are left, at which nobody can click
        points, had = view.glance_points, glance
    beside = f" where its keyframes have up to {had}" if had else ""
    text = (
        f"{robot.name} sees hardly anything that has depth ({points} points{beside}): is a lens "
        "dark or covered, is an eye frozen, have eyes changed places, has a camera moved "
        "(robot-agent calibrate-check), or is there only a blank wall?"
    )
    _note(site, robot, text, is_blind=points < max(LEAST_POINTS, _LEFT * had))


def note_without_depth(site: Site, robot: Robot) -> None:
    """Notes that a robot's newest view was refused for having no depth to speak of."""
    text = (
        f"{robot.name} sees nothing that has depth, and its views are refused for it: is a lens "
        "dark or covered, is an eye frozen?"
    )
    _note(site, robot, text, is_blind=True)


def _note(site: Site, robot: Robot, text: str, *, is_blind: bool) -> None:
    if is_blind != bool(robot.blind):
        said = text if is_blind else f"{robot.name} sees enough that has depth again"
        site.say(said)
        log.warning("blind robot=%s text=%s", robot.name, said)
    robot.note_blind(text if is_blind else "")


def blind_alarms(site: Site) -> tuple[Alarm, ...]:
    """An alarm for every robot that is there and sees hardly anything."""
    return tuple(
        Alarm(robot=name, kind="blind", text=robot.blind)
        for name, robot in sorted(site.robots.items())
        if robot.blind and robot.alive
    )
