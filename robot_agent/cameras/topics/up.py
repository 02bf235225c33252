"""Where up is, by what a robot knows of gravity: an accelerometer at rest, odometry, or tf.

Odometry and the uppermost frame of tf are taken to be level, as REP-103 and REP-105 ask of them.
"""

import logging
from collections import deque
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.cameras.topics.mounting import Mounting
from fleetpose.robot_agent.cameras.topics.options import UpSource
from fleetpose.rosmsg.motion.inertial import GRAVITY_M_S2, InertialReading
from fleetpose.rosmsg.transforms import Tf

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float64]

SIGMA_RAD = float(np.radians(2.0))  # bias of an accelerometer, drift of an odometry
_Z = np.array((0.0, 0.0, 1.0))
_NEAR_NS = 500_000_000  # readings of a moment are averaged: a single one shakes
_KEPT = 400
_TOGETHER = 0.9  # of gravity, in the mean of readings that point the same way
_AGREE_RAD = np.radians(10.0)
_LEANS_RAD = np.radians(45.0)
"""A body that leans further by its odometry does not lean: the odometry is that of a camera."""


class Up(NamedTuple):
    """Up in some frame, (3,) of length 1, and its sigma."""

    direction: Floats
    sigma_rad: float = SIGMA_RAD


class UpSense:
    """Says where up is in the robot's frame.

    Args:
        source: what tells; `auto` is an accelerometer at rest, else odometry, unless that is seen
            not to be level.
        tf: which frame hangs where.
        where: how the camera hangs on the robot.
        camera: the camera's frame.
    """

    def __init__(self, source: UpSource, tf: Tf, where: Mounting, camera: str) -> None:
        self._source, self._tf, self._where, self._camera = source, tf, where, camera
        self._readings: deque[InertialReading] = deque(maxlen=_KEPT)
        self._told: set[str] = set()
        self._doubted = False

    def needs(self, what: UpSource) -> bool:
        """Whether a source of that kind may be asked."""
        return self._source == what or (self._source == "auto" and what in ("odom", "imu"))

    def note(self, reading: InertialReading) -> None:
        """A sample of an accelerometer."""
        self._readings.append(reading)

    def at(self, stamp_ns: int, T_robot_camera: Floats, T_odom_robot: Floats | None) -> Up | None:
        """Up in the robot's frame at a moment, None where nothing tells.

        Args:
            stamp_ns: the moment.
            T_robot_camera: (4, 4) of the camera's own axes.
            T_odom_robot: (4, 4) by its odometry, if it has one and its body is known in tf.
        """
        felt = self._felt(stamp_ns, T_robot_camera) if self.needs("imu") else None
        driven = None if T_odom_robot is None else T_odom_robot[:3, :3].T @ _Z
        if self._source == "odom":
            return None if driven is None else Up(driven)
        if self._source == "tf":
            return self._by_tf(stamp_ns)
        if self._source == "auto" and driven is not None:
            self._doubt(driven, felt)
            if felt is None and not self._doubted:
                return Up(driven)
        return None if felt is None else Up(felt)

    def _felt(self, stamp_ns: int, T_robot_camera: Floats) -> Floats | None:
        """The mean of what the accelerometer says, if it is at rest all along."""
        near = [one for one in self._readings if abs(one.stamp_ns - stamp_ns) <= _NEAR_NS]
        if not near or not all(one.is_at_rest for one in near):
            return None
        T_robot_imu = self._from_imu(near[0].frame, stamp_ns, T_robot_camera)
        if T_robot_imu is None:
            self._tell("tf does not say where its Imu sits: it cannot tell where up is")
            return None
        up = T_robot_imu[:3, :3] @ np.mean([one.acceleration for one in near], axis=0)
        felt = float(np.linalg.norm(up))
        return up / felt if felt > _TOGETHER * GRAVITY_M_S2 else None

    def _from_imu(self, frame: str, stamp_ns: int, T_robot_camera: Floats) -> Floats | None:
        if self._where.base:
            return self._tf.lookup(self._where.base, frame, stamp_ns)
        T_camera_imu = self._tf.lookup(self._camera, frame, stamp_ns)
        return None if T_camera_imu is None else T_robot_camera @ T_camera_imu

    def _by_tf(self, stamp_ns: int) -> Up | None:
        top = self._tf.top(self._where.base) if self._where.base else ""
        if not top or top == self._where.base:
            self._tell("tf has no frame above the robot's: it cannot tell where up is")
            return None
        T_top_robot = self._tf.lookup(top, self._where.base, stamp_ns)
        return None if T_top_robot is None else Up(T_top_robot[:3, :3].T @ _Z)

    def _doubt(self, driven: Floats, felt: Floats | None) -> None:
        """Odometry that is seen not to be level is not asked again."""
        if self._doubted:
            return
        if felt is not None and (off := _between(driven, felt)) > _AGREE_RAD:
            why = f"its accelerometer says otherwise by {np.degrees(off):.0f} deg"
        elif felt is None and (off := _between(driven, _Z)) > _LEANS_RAD:
            why = f"by it the robot leans by {np.degrees(off):.0f} deg"
        else:
            return
        self._doubted = True
        self._tell(f"its odometry is not level: {why}; it is not asked where up is (--up odom)")

    def _tell(self, sentence: str) -> None:
        if sentence not in self._told:
            self._told.add(sentence)
            log.warning("%s", sentence)


def _between(a: Floats, b: Floats) -> float:
    return float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
