"""A robot of the synthetic world with something wrong: its calibration, its clock, its trigger, or
the driver of its camera.

The robot's own program is as it always is; what it is given is wrong.
"""

import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

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


@dataclass(frozen=True)
class FaultyCamera:
    """Frames that are spoilt on their way, of a robot in the synthetic world."""

    cameras: tuple[SyntheticCamera, ...]
    spoilt: Iterator[Frame]

    def frames(self) -> Iterator[Frame]:
        return self.spoilt

    def close(self) -> None:
        for camera in self.cameras:
            camera.close()


def open_faulty(fault: str, source: str) -> FaultyCamera:
    """Opens a camera of the synthetic world with a fault: `skew`, `clock`, `baseline`, `mirrored`.

    Raises:
        FleetPoseError: there is no such fault, or no such world.
    """
    link = WorldLink(source)
    match fault:
        case "skew":
            cameras = SyntheticCamera(link), SyntheticCamera(WorldLink(f"{source}@{SKEW_MS}"))
            return FaultyCamera(cameras, depths_of_before(*(c.frames() for c in cameras)))
        case "clock":
            camera = SyntheticCamera(link)
            return FaultyCamera((camera,), stamps_ahead(camera.frames()))
        case "baseline":
            link.calibration["t"] = [BASELINE_RATIO * x for x in link.calibration["t"]]
            camera = SyntheticCamera(link)
            return FaultyCamera((camera,), camera.frames())
        case "mirrored":
            camera = SyntheticCamera(link)
            return FaultyCamera((camera,), flipped(camera.frames()))
    raise FleetPoseError(f"no fault '{fault}': there are skew, clock, baseline and mirrored")


def depths_of_before(frames: Iterator[Frame], before: Iterator[Frame]) -> Iterator[Frame]:
    """Each image with depths that were measured before it."""
    for frame in frames:
        yield replace(frame, ranges=next(before).ranges)


def stamps_ahead(frames: Iterator[Frame]) -> Iterator[Frame]:
    """Frames by a clock that is 3 s ahead."""
    for frame in frames:
        yield replace(frame, stamp_ns=frame.stamp_ns + round(1e9 * CLOCK_AHEAD_S))


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


def main() -> None:
    """Arguments NAME ENDPOINT SITE SOURCE FAULT RATE."""
    name, endpoint, site, source, fault, rate = sys.argv[1:]
    log_to_stderr()
    cv2.setNumThreads(1)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    settings = SessionSettings(connect=(endpoint,))
    camera = open_faulty(fault, source)
    try:
        with FleetRobot(name, settings, site, settings=SenderSettings(float(rate))) as robot:
            for frame in paced(camera.frames(), float(rate), stop):
                robot.push_frame(frame)
    finally:
        camera.close()


if __name__ == "__main__":
    main()
