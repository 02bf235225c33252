"""Alarms about the robots: what comparisons of their depths, their own views and the arrival of
their stamps say of calibrations and clocks, in words; and the event that something moves.
"""

import logging
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.findings import (
    LEAST_BEND_OTHER,
    LEAST_BEND_STEREO,
    Bend,
    Estimate,
    bend_of,
    time_offset,
    wrong_scales,
)
from fleetpose.pose_server.calibration.history import DepthStatement
from fleetpose.pose_server.calibration.links import SLOW_S, SlowLink
from fleetpose.pose_server.consistency.anchoring import anchor_alarms
from fleetpose.pose_server.consistency.blindness import blind_alarms
from fleetpose.pose_server.consistency.doubts import doubt_alarms
from fleetpose.pose_server.geometry.features.motion import Mask
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.protocol.messages import Alarm, Camera, CameraAnnouncement, ViewName

log = logging.getLogger("pose_server")

_NEAR_S = 2.0  # views that tell how fast a robot went are no farther apart
_FLOW_NEAR_S = 3.0
_MOVING_POINTS = 6  # a few that are wrong alike are no event
_MOTION_OVER_S = 30.0  # without motion for so long, the next one is told again
_CHECK = "`robot-agent calibrate-check`"


def standing(site: Site) -> tuple[Alarm, ...]:
    """All alarms that stand now."""
    return (
        *anchor_alarms(site),
        *doubt_alarms(site),
        *blind_alarms(site),
        *site.alarms.standing,
    )


def note_depths(site: Site, done: Done) -> None:
    """Keeps what an alignment of two robots' views says of their depths."""
    i, j = done.job.i.name, done.job.j.name
    if done.result is None or done.result.depths is None or i.robot == j.robot:
        return
    site.depths.note(
        i.robot,
        j.robot,
        DepthStatement(done.result.depths, forward_speed(site, i), forward_speed(site, j)),
    )


def note_mirror(site: Site, done: Done) -> None:
    """Keeps whether two robots' views fit as they are, or only if one of both is mirrored."""
    i, j = done.job.i.name.robot, done.job.j.name.robot
    result = done.result
    if result is None or i == j or not (result.mirrored or result.verdict == "verified"):
        return
    if site.depths.mirrors.note(i, j, result.mirrored):
        site.depths.note_change()


def note_time_offset(site: Site, done: Done) -> None:
    """Keeps what an alignment of a robot's own views says of when its depths are measured."""
    if done.result is not None and done.result.shift is not None:
        site.depths.moments.note(done.job.i.name, done.job.j.name, done.result.shift)
        site.depths.note_change()


def note_arrival(site: Site, view: KeptView, now_ns: int) -> None:
    """Keeps when a view arrived by the server's clock, which its robot's may be off from, and what
    it tells of its link. Views that a slow link delays tell nothing of a clock.
    """
    robot, epoch = view.name.robot, view.name.epoch
    if robot in site.robots:
        site.depths.links.note(robot, epoch, view.on_way_s, view.share)
        if view.on_way_s <= SLOW_S:
            site.depths.clocks.note(robot, epoch, 1e-9 * (view.stamp_ns - now_ns))
        site.depths.note_change()


def note_announcement(site: Site, announcement: CameraAnnouncement) -> None:
    """Keeps whose time a robot's stamps are of: a recording's arrive long after they were taken."""
    recorded = announcement.clock == "recorded"
    site.depths.clocks.note_recorded(announcement.robot, announcement.epoch, recorded)
    site.depths.note_change()


def note_motion(site: Site, view: ViewName, mask: Mask | None) -> None:
    """Says that something moves in a robot's view, once while it goes on; a second view must see it
    too: in one alone a few wrong matches agree now and then.
    """
    if mask is None or len(mask.moving) < _MOVING_POINTS or view not in site.views:
        return
    track, now_s = site.robot(view.robot).track, site.views[view].received_s
    goes_on = now_s - track.motion_s <= _MOTION_OVER_S
    if goes_on and not track.motion_told:
        event = (
            f"something moves in {view.robot}'s view {view.seq}: what is around "
            f"{len(mask.moving)} points of it is left out of alignments"
        )
        site.say(event)
        log.info("%s", event)
    track.note_motion(now_s, told=goes_on)


def judge_calibrations(site: Site) -> None:
    """Renews the alarms; a new one is an event as well."""
    changed, compared = site.depths.take_changes()
    if not changed:
        return
    if compared:
        site.alarms.keep_distortions(_of_bends(site))
    alarms = list(site.alarms.distortions)
    bent = {alarm.robot for alarm in alarms}
    alarms += _of_scales(site, bent)
    alarms += _of_skews(site, bent)
    alarms += _of_clocks(site)
    alarms += _of_links(site)
    alarms += _of_mirrors(site)
    for alarm in site.alarms.renew(alarms):
        site.say(alarm.text)
        log.warning("alarm robot=%s kind=%s text=%s", alarm.robot, alarm.kind, alarm.text)


def forward_speed(site: Site, view: ViewName) -> float:
    """By what share of the depth a robot went forward in a second around a view, nan where that is
    not known.
    """
    robot = site.robots.get(view.robot)
    if robot is None or view not in site.views:
        return float("nan")
    here = site.views[view]
    near = {
        other: 1e-9 * (site.views[other].stamp_ns - here.stamp_ns)
        for other in robot.track.attached
        if other != view and other.epoch == view.epoch and other in site.views
    }
    near = {other: dt_s for other, dt_s in near.items() if 0 < abs(dt_s) < _NEAR_S}
    other = min(near, key=lambda name: abs(near[name]), default=None)
    T_view_other = None if other is None else site.relative(view, other)
    if other is None or T_view_other is None:
        return float("nan")
    return float(T_view_other[2, 3]) / near[other] / here.median_depth_m


def _of_bends(site: Site) -> list[Alarm]:
    alarms = []
    for robot in site.depths.robots:
        inverse_depth = site.depths.inverse_depth(robot)
        camera = site.robots[robot].camera if robot in site.robots else None
        if camera is None:
            continue
        stereo = camera.noise.focal_baseline_px_m is not None
        least = LEAST_BEND_STEREO if stereo else LEAST_BEND_OTHER
        bend = bend_of(site.depths.bends(robot), inverse_depth, least)
        if bend is not None:
            text = _bend_text(robot, bend, inverse_depth, camera)
            alarms.append(Alarm(robot=robot, kind="bent", text=text))
    return alarms


def _of_scales(site: Site, bent: set[str]) -> list[Alarm]:
    found = wrong_scales(site.depths.scales(without=bent))
    alarms = [
        Alarm(robot=robot, kind="scale", text=_scale_text(site, robot, estimate))
        for robot, estimate in found.wrong.items()
    ]
    for (a, b), estimate in found.undecided.items():
        text = (
            f"the depths of {a} are {_percent(estimate, too=False)} than those of {b}: one "
            "of both is off, and no third robot that sees the same tells which: check both "
            f"({_CHECK})"
        )
        alarms += [Alarm(robot=robot, kind="unequal", text=text) for robot in (a, b)]
    return alarms


def _of_skews(site: Site, bent: set[str]) -> list[Alarm]:
    """Robots whose depths are of another moment than their images: a robot that turns sees them
    beside the image, one that goes forward sees them too long or too short.
    """
    alarms = []
    for robot in sorted({*site.depths.robots, *site.depths.moments.robots}):
        for view in site.depths.moments.without_flow(robot):
            motion = flow(site, view)
            if motion is not None:
                site.depths.moments.note_flow(view, motion)
        older = site.depths.moments.offset(robot)
        if older is None and robot not in bent:
            younger = time_offset(*site.depths.paces(robot))
            older = None if younger is None else replace(younger, value=-younger.value)
        if older is not None:
            text = (
                f"{robot}'s depths are {1e3 * abs(older.value):.0f} +- {1e3 * older.sigma:.0f} "
                f"ms {'older' if older.value > 0 else 'younger'} than its images, by how both fit "
                "as it moves: check that both are taken at one moment"
            )
            alarms.append(Alarm(robot=robot, kind="skew", text=text))
    return alarms


def _of_clocks(site: Site) -> list[Alarm]:
    site.depths.clocks.keep_only({r for r, robot in site.robots.items() if robot.alive})
    alarms = []
    for robot, ahead_s in site.depths.clocks.wrong():
        if ahead_s > 0:
            what = f"the clock of {robot} is {ahead_s:.1f} s ahead of the server's"
        else:
            what = (
                f"the views of {robot} arrive {-ahead_s:.1f} s after their stamps at best: its "
                "clock is behind the server's, or it sends them late"
            )
        text = f"{what}; the stamps of its poses are in its own clock: set it by NTP or chrony"
        alarms.append(Alarm(robot=robot, kind="clock", text=text))
    return alarms


def _of_links(site: Site) -> list[Alarm]:
    """Robots whose views are late on their way, or have less in them for not to be."""
    site.depths.links.keep_only({r for r, robot in site.robots.items() if robot.alive})
    return [
        Alarm(
            robot=slow.robot,
            kind="link",
            text=f"the link of {slow.robot} is slow: {_on_its_way(slow)}; give it a better one, or "
            "fewer frames per second where several share it",
        )
        for slow in site.depths.links.slow()
    ]


def _on_its_way(slow: SlowLink) -> str:
    less = f"{slow.share:.0%} of its salient points"
    if slow.on_way_s > SLOW_S:
        return f"a view takes {slow.on_way_s:.1f} s and holds {less}"
    return f"only with {less} does a view come in time"


def _of_mirrors(site: Site) -> list[Alarm]:
    """Robots whose cameras flip their images."""
    alarms = []
    for flipped in site.depths.mirrors.flipped():
        names = ", ".join(sorted(flipped.robots))
        for robot, partners in sorted(flipped.robots.items()):
            what = (
                f"{robot}'s images are mirrored, by {partners} partner{'s' if partners > 1 else ''}"
                if flipped.sure
                else f"of {names} some robots' images are mirrored, and nothing tells whose"
            )
            text = f"{what}: its camera's driver flips them, turn that off"
            alarms.append(Alarm(robot=robot, kind="mirrored", text=text))
    return alarms


def flow(site: Site, view: ViewName) -> npt.NDArray[np.floating] | None:
    """How fast a robot's image moved in its middle when a view was taken, (2,) px/s, by the views
    before and after it, or after it for the first one of a life; None where that is not known.
    """
    robot, here = site.robots.get(view.robot), site.views.get(view)
    if robot is None or here is None:
        return None
    sides: dict[bool, tuple[float, ViewName]] = {}
    for other in robot.track.attached:
        if other != view and other.epoch == view.epoch and other in site.views:
            dt_s = 1e-9 * (site.views[other].stamp_ns - here.stamp_ns)
            best = sides.get(dt_s > 0, (_FLOW_NEAR_S, view))
            if 0 < abs(dt_s) < abs(best[0]):
                sides[dt_s > 0] = dt_s, other
    flows = []
    for dt_s, other in sides.values():
        T_other_view = site.relative(other, view)
        if T_other_view is not None:
            middle = T_other_view[:3, 2] * here.median_depth_m + T_other_view[:3, 3]
            K = here.camera.K
            flows.append(np.diag(K)[:2] * middle[:2] / max(middle[2], 1e-6) / dt_s)
    is_first = here.stamp_ns <= min(
        site.views[other].stamp_ns
        for other in (*robot.track.attached, view)
        if other.epoch == view.epoch and other in site.views
    )
    return np.mean(flows, axis=0) if len(flows) == 1 + (not is_first) else None


def _scale_text(site: Site, robot: str, estimate: Estimate) -> str:
    camera = site.robots[robot].camera if robot in site.robots else None
    stereo = camera is not None and camera.noise.focal_baseline_px_m is not None
    what = f"check its baseline ({_CHECK})" if stereo else "check its depth scale"
    return (
        f"{robot}'s depths are {_percent(estimate, too=True)} against {estimate.partners} "
        f"partner{'s' if estimate.partners > 1 else ''}: {what}"
    )


def _percent(estimate: Estimate, too: bool) -> str:
    percent, sigma = 100 * np.expm1(estimate.value), 100 * estimate.sigma
    longer = "long" if percent > 0 else "short"
    return f"{abs(percent):.1f} +- {sigma:.1f} % " + (f"too {longer}" if too else f"{longer}er")


def _bend_text(robot: str, bend: Bend, inverse_depth: float, camera: Camera) -> str:
    """For a stereo camera in pixels of disparity, and as what turn of one of the two it looks."""
    focal_baseline = camera.noise.focal_baseline_px_m
    if focal_baseline is None:
        middle, right, low = 100 * bend.value / inverse_depth
        sigma = 100 * bend.sigma[0] / inverse_depth
        return (
            f"{robot}'s inverse depths are off by {middle:+.0f} +- {sigma:.0f} % in the middle of "
            f"the image, {right:+.0f} % more at its right and {low:+.0f} % at its lower edge, "
            f"against {bend.partners} partners: check its depth calibration"
        )
    middle, right, low = focal_baseline * bend.value
    sigma = focal_baseline * bend.sigma
    turned = np.degrees(np.hypot(middle / camera.K[0, 0], low / (0.5 * camera.height)))
    return (
        f"{robot}'s disparities are off by {middle:+.1f} +- {sigma[0]:.1f} px in the middle of the "
        f"image, {right:+.1f} +- {sigma[1]:.1f} px more at its right and {low:+.1f} +- "
        f"{sigma[2]:.1f} px at its lower edge, against {bend.partners} partners, as if one of its "
        f"two cameras were turned by {turned:.1f} deg: check its calibration "
        f"({_CHECK})"
    )
