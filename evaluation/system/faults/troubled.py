"""A robot of the synthetic world with something wrong: its calibration, its clock, its trigger, the
driver of its camera; or one that is well until it gets SIGUSR1, and tells what became of it.

The robot's own program is as it always is; what its devices give it is not. With trouble that comes
later it writes a line of JSON for every frame: its stamp, the place in the world where it truly
stands, and how far it has driven from there. Only the evaluation reads these.
"""

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.simulate.replay_robots import stop_at_signals
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.transport import SessionSettings
from fleetpose.robot_agent.agent import paced
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, Frame
from fleetpose.robot_agent.cameras.synthetic import SyntheticCamera, WorldLink
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.sender import SenderSettings

SKEW_MS = 200
CLOCK_AHEAD_S = 3.0
BASELINE_RATIO = 1.05
CLOCK_BACK_S = 60.0
SPEED_M_S = 0.5

Image = npt.NDArray[np.uint8]
Trouble = threading.Event


@dataclass(frozen=True)
class Shown:
    """A frame as the robot gets it, and the truth of it.

    Attributes:
        place: where the robot stands, by its name in the world; empty where that is not told.
        driven_m: how far forward it has driven from there.
        wheels: whether the robot has odometry, which says so too.
    """

    frame: Frame
    place: str = ""
    driven_m: float = 0.0
    wheels: bool = False


class FrozenLink(WorldLink):
    """Its driver hands out the last images for ever, with new stamps, while there is trouble."""

    def __init__(self, source: str, trouble: Trouble) -> None:
        super().__init__(source)
        self._trouble = trouble
        self._last: tuple[Image, Image] | None = None

    def next(self) -> tuple[Image, Image, int]:
        if self._last is not None and self._trouble.is_set():
            return *self._last, time.time_ns()
        left, right, stamp_ns = super().next()
        self._last = left, right
        return left, right, stamp_ns


def frozen(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The camera freezes, and the robot drives off."""
    return _driving(SyntheticCamera(FrozenLink(sources[0], trouble)), sources[0], trouble)


def still(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The camera sees nothing but what moves with the robot, and the robot drives off."""
    return _driving(SyntheticCamera(WorldLink(sources[0])), sources[0], trouble)


def kidnapped(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """Somebody carries the robot to another place, and back when the trouble is over."""
    cameras = [SyntheticCamera(WorldLink(source)).frames() for source in sources]
    while True:
        where = int(trouble.is_set())
        yield Shown(next(cameras[where]), _place(sources[where]))


def clock_step(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The robot's clock is set back."""
    for frame in SyntheticCamera(WorldLink(sources[0])).frames():
        back_ns = round(1e9 * CLOCK_BACK_S) if trouble.is_set() else 0
        yield Shown(replace(frame, stamp_ns=frame.stamp_ns - back_ns), _place(sources[0]))


def skew(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """Each image comes with depths that were measured before it."""
    del trouble
    before = SyntheticCamera(WorldLink(f"{sources[0]}@{SKEW_MS}")).frames()
    for frame in SyntheticCamera(WorldLink(sources[0])).frames():
        yield Shown(replace(frame, ranges=next(before).ranges))


def clock(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The robot's clock is 3 s ahead."""
    del trouble
    for frame in SyntheticCamera(WorldLink(sources[0])).frames():
        yield Shown(replace(frame, stamp_ns=frame.stamp_ns + round(1e9 * CLOCK_AHEAD_S)))


def baseline(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The calibration states a baseline that is 5 % too long."""
    del trouble
    link = WorldLink(sources[0])
    link.calibration["t"] = [BASELINE_RATIO * x for x in link.calibration["t"]]
    yield from map(Shown, SyntheticCamera(link).frames())


def mirrored(sources: list[str], trouble: Trouble) -> Iterator[Shown]:
    """The driver turns images and depths round."""
    del trouble
    yield from map(Shown, flipped(SyntheticCamera(WorldLink(sources[0])).frames()))


def flipped(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Frames whose images and depths are the wrong way round, with intrinsics that know nothing of
    it: the default of a common driver.
    """
    for frame in frames:
        ranges = frame.ranges
        match ranges:
            case DisparityImage():
                turned = np.ascontiguousarray(ranges.disparity_px[:, ::-1])
                ranges = replace(ranges, disparity_px=turned)
            case DepthImage():
                turned = np.ascontiguousarray(ranges.depth_m[:, ::-1])
                ranges = replace(ranges, depth_m=turned)
            case _:
                raise FleetPoseError("only images of depth or disparity can be flipped")
        yield replace(frame, image=np.ascontiguousarray(frame.image[:, ::-1]), ranges=ranges)


TROUBLES: dict[str, Callable[[list[str], Trouble], Iterator[Shown]]] = {
    "skew": skew,
    "clock": clock,
    "baseline": baseline,
    "mirrored": mirrored,
    "frozen": frozen,
    "still": still,
    "kidnapped": kidnapped,
    "clock-step": clock_step,
}


def _driving(camera: SyntheticCamera, source: str, trouble: Trouble) -> Iterator[Shown]:
    off_ns: int | None = None
    for frame in camera.frames():
        if trouble.is_set() and off_ns is None:
            off_ns = frame.stamp_ns
        driven_m = 0.0 if off_ns is None else SPEED_M_S * 1e-9 * (frame.stamp_ns - off_ns)
        yield Shown(frame, _place(source), driven_m, wheels=True)


def _place(source: str) -> str:
    return source.partition("/")[2]


def _tell(shown: Shown) -> None:
    line = {"stamp_ns": shown.frame.stamp_ns, "place": shown.place, "driven_m": shown.driven_m}
    print(json.dumps(line), flush=True)


def _push(robot: FleetRobot, shown: Shown) -> None:
    if shown.wheels:
        T_odom_robot = np.eye(4)
        T_odom_robot[0, 3] = shown.driven_m
        robot.push_odometry(T_odom_robot, shown.frame.stamp_ns)
    robot.push_frame(shown.frame)


def main() -> None:
    """Arguments TROUBLE NAME ENDPOINT SITE RATE SOURCE...."""
    kind, name, endpoint, site, rate, *sources = sys.argv[1:]
    if kind not in TROUBLES:
        raise FleetPoseError(f"no trouble '{kind}': there are {', '.join(TROUBLES)}")
    log_to_stderr()
    cv2.setNumThreads(1)
    stop, trouble = stop_at_signals(), Trouble()
    signal.signal(signal.SIGUSR1, lambda *_: trouble.clear() if trouble.is_set() else trouble.set())
    settings = SessionSettings(connect=(endpoint,))
    with FleetRobot(name, settings, site, settings=SenderSettings(float(rate))) as robot:
        for shown in paced(TROUBLES[kind](sources, trouble), float(rate), stop):
            if shown.place:
                _tell(shown)
            _push(robot, shown)


if __name__ == "__main__":
    main()
