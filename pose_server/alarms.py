"""Alarms about the robots' calibrations: what the comparisons of their depths say, in words."""

import logging

import numpy as np

from pose_server.calibration.findings import (
    LEAST_BEND_OTHER,
    LEAST_BEND_STEREO,
    Bend,
    Estimate,
    bend_of,
    time_offset,
    wrong_scales,
)
from pose_server.calibration.memory import Said
from pose_server.pairs.engine import Done
from pose_server.site import Site
from protocol.messages import Alarm, Camera, ViewName

log = logging.getLogger("pose_server")

_NEAR_S = 2.0  # views that tell how fast a robot went are no farther apart
_CHECK = "`robot-agent calibrate-check`"


def note_depths(site: Site, done: Done) -> None:
    """Keeps what an alignment of two robots' views says of their depths."""
    i, j = done.job.i.name, done.job.j.name
    if done.result is None or done.result.depths is None or i.robot == j.robot:
        return
    site.depths.note(i.robot, j.robot, Said(done.result.depths, pace(site, i), pace(site, j)))


def judge_calibrations(site: Site) -> None:
    """Renews the alarms; a new one is an event as well."""
    if not site.depths.changed:
        return
    site.depths.changed = False
    alarms = _of_bends(site)
    bent = {alarm.robot for alarm in alarms}
    alarms += _of_scales(site, bent)
    alarms += _of_clocks(site, bent)
    site.alarms = tuple(alarms)
    for alarm in alarms:
        if (alarm.robot, alarm.kind) not in site.alarms_told:
            site.alarms_told.add((alarm.robot, alarm.kind))
            site.say(alarm.text)
            log.warning("alarm robot=%s kind=%s text=%s", alarm.robot, alarm.kind, alarm.text)


def pace(site: Site, view: ViewName) -> float:
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


def _of_clocks(site: Site, bent: set[str]) -> list[Alarm]:
    alarms = []
    for robot in site.depths.robots:
        offset = None if robot in bent else time_offset(*site.depths.paces(robot))
        if offset is not None:
            text = (
                f"{robot}'s depths are {1e3 * abs(offset.value):.0f} +- {1e3 * offset.sigma:.0f} "
                f"ms {'younger' if offset.value > 0 else 'older'} than its images, by how they "
                "change with its speed: check that both are taken at one moment"
            )
            alarms.append(Alarm(robot=robot, kind="clock", text=text))
    return alarms


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
