"""The client of the synthetic world: a live stereo camera whose images come over a socket.

The world sends the rig and images and nothing else. Where the camera sits on the robot is the
robot's own knowledge: 1.2 m above the middle of its body, tilted up by 5 degrees.
"""

import json
import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import FleetPoseError, UnreachableError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.calibrations.reading import rig_of
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher

CAMERA_HEIGHT_M = 1.2
CAMERA_TILT_DEG = 5.0
CONNECT_S = 10.0
ANSWER_S = 60.0  # a world that has just been started builds its textures first
MAX_LINE = 64 * 1024
MAX_IMAGE_BYTES = 64 * 1024 * 1024


def mount() -> npt.NDArray[np.float64]:
    """`T_robot_camera` (4, 4) of the synthetic robots; the body's origin is on the ground."""
    tilt = np.radians(CAMERA_TILT_DEG)
    T = np.eye(4)
    T[:3, :3] = (
        (np.cos(tilt), 0.0, -np.sin(tilt)),
        (0.0, 1.0, 0.0),
        (np.sin(tilt), 0.0, np.cos(tilt)),
    )
    T[2, 3] = CAMERA_HEIGHT_M
    return T @ ROBOT_FROM_CAMERA


class WorldLink:
    """A connection to a world as one of its robots."""

    def __init__(self, source: str) -> None:
        self._source = source
        host, port, robot = _parsed(source)
        self._socket = _connect(source, host, port)
        self._socket.settimeout(ANSWER_S)
        self._stream = self._socket.makefile("rb")
        try:
            self.calibration = self._ask({"robot": robot})
        except FleetPoseError:
            self.close()
            raise

    def next(self) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8], int]:
        """Left and right image (H, W, 3) of now, and their stamp.

        Raises:
            UnreachableError: the world has gone, or says why it has no images.
        """
        header = self._ask("next")
        try:
            shape = int(header["height"]), int(header["width"]), 3
            stamp_ns = int(header["stamp_ns"])
            sizes = int(header["left_bytes"]), int(header["right_bytes"])
        except (KeyError, TypeError, ValueError) as error:
            raise UnreachableError(f"{self._source} is no synthetic world: {header}") from error
        if min(shape) < 1 or sizes != (np.prod(shape),) * 2 or sizes[0] > MAX_IMAGE_BYTES:
            raise UnreachableError(f"{self._source} announces impossible images: {header}")
        left, right = (np.frombuffer(self._read(n), np.uint8).reshape(shape) for n in sizes)
        return left, right, stamp_ns

    def close(self) -> None:
        with suppress(OSError):
            self._stream.close()
            self._socket.close()

    def _ask(self, request: Any) -> dict[str, Any]:
        try:
            self._socket.sendall(json.dumps(request).encode() + b"\n")
            line = self._stream.readline(MAX_LINE)
        except (OSError, ValueError) as error:  # ValueError: closed on our side
            raise UnreachableError(f"the world at {self._source} has gone: {error}") from error
        if not line.endswith(b"\n"):
            raise UnreachableError(f"the world at {self._source} has gone")
        try:
            answer = json.loads(line)
        except ValueError as error:
            raise UnreachableError(f"{self._source} is no synthetic world") from error
        if not isinstance(answer, dict) or "error" in answer:
            raise UnreachableError(f"the world at {self._source} says: {answer}")
        return answer

    def _read(self, count: int) -> bytes:
        try:
            data = self._stream.read(count)
        except (OSError, ValueError) as error:
            raise UnreachableError(f"the world at {self._source} has gone: {error}") from error
        if len(data) != count:
            raise UnreachableError(
                f"the world at {self._source} has gone in the middle of an image"
            )
        return data


class SyntheticCamera:
    """A robot's stereo camera in the synthetic world; it never ends by itself."""

    def __init__(self, link: WorldLink) -> None:
        self._link = link
        rig = rig_of(link.calibration, "the world's calibration")
        self._matcher = StereoMatcher(replace(rig, T_robot_left=mount()))

    def frames(self) -> Iterator[Frame]:
        while True:
            left, right, stamp_ns = self._link.next()
            yield replace(self._matcher.frame(left, right, stamp_ns), raw=(left, right))

    def close(self) -> None:
        self._link.close()


def open_camera(source: str, replay: str) -> SyntheticCamera:
    """Connects to a world; waits up to 10 s for it to listen.

    Args:
        source: `host:port/robot`, e.g. `127.0.0.1:7500/r3`.
        replay: of no meaning for a live camera.

    Raises:
        UnreachableError: there is no world, or no such robot in it.
        FleetPoseError: the source is no such place.
    """
    del replay
    link = WorldLink(source)
    try:
        return SyntheticCamera(link)
    except FleetPoseError:
        link.close()
        raise


def _parsed(source: str) -> tuple[str, int, str]:
    address, _, robot = source.partition("/")
    host, _, port = address.rpartition(":")
    if not host or not port.isdigit() or not 0 < int(port) < 65536 or not robot:
        raise FleetPoseError(f"'{source}' is no place in a world: give host:port/robot")
    return host, int(port), robot


def _connect(source: str, host: str, port: int) -> socket.socket:
    end = time.monotonic() + CONNECT_S
    while True:
        try:
            return socket.create_connection((host, port), timeout=CONNECT_S)
        except OSError as error:
            if time.monotonic() > end:
                raise UnreachableError(
                    f"no synthetic world at {source}: {error}; start one with 'pose-eval world'"
                ) from error
            time.sleep(0.1)
