"""The agent's loop: camera -> frames at a steady rate -> fleet."""

import logging
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import fields
from typing import TypeVar

import cv2

from fleetpose.protocol.errors import EndedError
from fleetpose.protocol.session.supervisor import Supervisor
from fleetpose.protocol.transport import SessionSettings
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.folders.pairing import MAX_SKEW_MS
from fleetpose.robot_agent.cameras.kinds import clock_of
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.robot_agent.cameras.stereo.video import video_settings
from fleetpose.robot_agent.cameras.understood import understood_of
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.hearing import UNHEARD_S
from fleetpose.robot_agent.sender import SenderSettings
from fleetpose.robot_agent.settings import RobotSettings

log = logging.getLogger(__name__)

T = TypeVar("T")
Options = TypeVar("Options", BagOptions, RosOptions)
_LOOK_S = 1.0


def run_agent(settings: RobotSettings, stop: threading.Event) -> None:
    """Runs until the camera has no more frames or the event is set.

    The session is closed in any case.

    Raises:
        FleetPoseError: the camera, the router or the name cannot be had.
    """
    cv2.setNumThreads(settings.opencv_threads or -1)
    systemd = Supervisor()
    camera = open_camera(
        settings.camera,
        settings.data,
        settings.replay,
        clouds=settings.clouds,
        view=settings.view,
        metres_per_unit=settings.metres_per_unit,
        axes=settings.axes,
        calibration=settings.calibration,
        video=video_settings(
            *(settings.size, settings.fps, settings.fourcc),
            settings.max_skew_ms or MAX_SKEW_MS,
            settings.eyes,
        ),
        stop=stop,
        translation_unit=settings.translation_unit,
        depth_scale=settings.depth_scale,
        bag=_options(BagOptions, settings),
        ros=_options(RosOptions, settings),
        waiting=systemd.alive,
    )
    try:
        systemd.ready()
        with FleetRobot(
            settings.name,
            SessionSettings(
                connect=settings.connect,
                config_file=settings.config,
                timeout_s=settings.connect_timeout_s,
                stop=stop,
                waiting=systemd.alive,
            ),
            site=settings.site,
            settings=SenderSettings(
                rate_hz=settings.rate_hz,
                max_salient=settings.max_salient,
                jpeg_quality=settings.jpeg_quality,
                keep_views=settings.keep_views,
                clock=clock_of(settings.camera),
            ),
            takeover=settings.takeover,
        ) as robot:
            log.info("started name=%s epoch=%s camera=%s", robot.name, robot.epoch, settings.camera)
            heard = _Told(robot)

            def between() -> None:
                systemd.alive(_status(robot))

            sight = Sight(robot.name)
            for frame in paced(camera.frames(), settings.rate_hz, stop, between):
                sight.log(frame)
                robot.push_frame(frame)
                heard.log()
            if not stop.is_set():
                robot.flush()
            heard.log()
            log.info(
                "ended name=%s reason=%s",
                robot.name,
                _why_ended(stop, settings),
            )
    except EndedError as error:
        log.info("ended name=%s reason=%s", settings.name, error)
    finally:
        systemd.stopping()
        camera.close()


def _why_ended(stop: threading.Event, settings: RobotSettings) -> str:
    if stop.is_set():
        return "asked"
    goes_on = settings.replay == "once" and settings.camera in ("rgbd", "stereo")
    return "no more frames" + "; --replay loop would go on" * goes_on


def _options(kind: type[Options], settings: RobotSettings) -> Options:
    """Those of the settings that a kind of cameras has as options of its own."""
    return kind(**{field.name: getattr(settings, field.name) for field in fields(kind)})


def _status(robot: FleetRobot) -> str:
    """How it is, in a line."""
    if (unheard_s := robot.unheard_s) > UNHEARD_S:
        return f"not heard for {10 * (unheard_s // 10):.0f} s or more"
    return "starting" if robot.heard_age_s is None else "heard"


class Sight:
    """Logs what is understood of the camera: of the first frame all, later when depth goes thin,
    and when it is back.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._thin: bool | None = None

    def log(self, frame: Frame) -> None:
        seen = understood_of(frame)
        if seen.is_thin == self._thin:
            return
        if self._thin is None or not seen.is_thin:
            log.info("understood name=%s %s", self._name, seen)
        if seen.is_thin:
            log.warning(
                "hardly any depth name=%s %s: is a lens dark or covered, is an eye frozen, has a "
                "camera moved (robot-agent calibrate-check), or is there only a blank wall?",
                *(self._name, seen),
            )
        self._thin = seen.is_thin


class _Told:
    """Logs what a robot hears of itself, each time that it changes."""

    def __init__(self, robot: FleetRobot) -> None:
        self._robot = robot
        self._dropped = 0
        self._located: bool | None = None

    def log(self) -> None:
        self._log_drops()
        self._log_located()

    def _log_drops(self) -> None:
        """The counts where they grew; what came first was logged as it came."""
        counts = self._robot.drops.snapshot()
        before, self._dropped = self._dropped, sum(counts.values())
        if self._dropped > before:
            by_reason = "; ".join(f"{reason} {n}" for reason, n in sorted(counts.items()))
            log.info(
                "drops name=%s total=%d by_reason=%s", self._robot.name, self._dropped, by_reason
            )

    def _log_located(self) -> None:
        """Whether it is located, and why it is not, as operators read it."""
        pose = self._robot.pose()
        if pose is None or pose.located == self._located:
            return
        self._located = pose.located
        if pose.located:
            log.info("located name=%s component=%s", pose.robot, pose.component)
        else:
            log.info("not located name=%s reason=%s", pose.robot, pose.why_not)


def paced(
    frames: Iterator[T],
    rate_hz: float,
    stop: threading.Event,
    between: Callable[[], None] = lambda: None,
) -> Iterator[T]:
    """Takes frames at a steady rate; time lost on a late one is not made up for. What is to be done
    between them is done at least once a second.
    """
    period_s = 1.0 / rate_hz
    due_s = time.monotonic()
    while not stop.wait(min(max(due_s - time.monotonic(), 0.0), _LOOK_S)):
        between()
        if time.monotonic() < due_s:
            continue
        frame = next(frames, None)
        if frame is None:
            return
        yield frame
        due_s = max(due_s + period_s, time.monotonic())


def end_with_parent(parent: int, stop: threading.Event, poll_s: float = 0.3) -> None:
    """Sets the event when the process that started this one is gone.

    Watched, not asked of the kernel: its death signal comes with the parent's *thread*, and on
    Linux only.
    """

    def watch() -> None:
        while os.getppid() == parent:
            if stop.wait(poll_s):
                return
        log.info("parent is gone pid=%d", parent)
        stop.set()

    threading.Thread(target=watch, name="parent", daemon=True).start()
