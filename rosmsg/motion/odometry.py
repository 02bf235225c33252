"""`nav_msgs/Odometry`: where a robot says that it is, and how sure."""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.rosmsg.camera_infos import frame_of
from fleetpose.rosmsg.stamps import stamp_ns
from fleetpose.rosmsg.transforms import pose_matrix

Floats = npt.NDArray[np.float64]

KEPT = 1000  # five seconds at 200 Hz
NEAR_NS = 100_000_000  # between two moments farther apart nothing is made up
_CORRELATED = 1.01  # at most, but for rounding
_UNKNOWN = 1e5  # variances by which drivers say that they do not know


@dataclass(frozen=True, eq=False)
class OdometryReading:
    """Where a body is in its own odometry frame.

    Attributes:
        stamp_ns: UTC of the robot's clock.
        T_odom_child: (4, 4).
        covariance: (6, 6) of it, left, rotation first; None where the message does not know.
        child_frame: the body's frame.
    """

    stamp_ns: int
    T_odom_child: Floats
    covariance: Floats | None
    child_frame: str = ""


def odometry_reading(message: Any) -> OdometryReading:
    """Of a message.

    Raises:
        CodecError: its pose is none.
    """
    pose = message.pose.pose
    T = pose_matrix(pose.position, pose.orientation)
    covariance = left_covariance(np.asarray(message.pose.covariance, np.float64), T)
    child = str(message.child_frame_id).lstrip("/")
    return OdometryReading(stamp_ns(message), T, covariance, child or frame_of(message))


def left_covariance(covariance: Floats, T: Floats) -> Floats | None:
    """(6, 6) of a left perturbation, rotation first, of what ROS gives: position first, then
    rotation about fixed axes at the robot. With xi = (phi, rho): phi = theta,
    rho = dp + p x theta.

    Args:
        covariance: 36 numbers.
        T: (4, 4) the pose.

    Returns:
        None where they say that nothing is known: zeros, -1, 1e6, nan, or are no covariance.
    """
    C = covariance.reshape(6, 6)
    variances = np.diag(C)
    if not np.isfinite(C).all() or (variances <= 0).any() or (variances > _UNKNOWN).any():
        return None
    most = np.sqrt(np.outer(variances, variances))
    if (np.abs(C) > _CORRELATED * most).any():
        return None
    x, y, z = T[:3, 3]
    J = np.zeros((6, 6))
    J[:3, 3:] = J[3:, :3] = np.eye(3)
    J[3:, 3:] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
    return J @ ((C + C.T) / 2) @ J.T


@dataclass
class Track:
    """The latest readings of one topic, in order."""

    _readings: deque[OdometryReading] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, reading: OdometryReading) -> None:
        """Takes a reading; one that is older than the newest is left out."""
        if not self._readings or self._readings[-1].stamp_ns < reading.stamp_ns:
            self._readings.append(reading)

    def at(self, stamp_ns: int) -> OdometryReading | None:
        """Where it was at a moment, between the readings before and after it; None where there is
        none nearby.
        """
        k = bisect_left([one.stamp_ns for one in self._readings], stamp_ns)
        before = self._readings[k - 1] if k else None
        after = self._readings[k] if k < len(self._readings) else None
        if before and after and after.stamp_ns - before.stamp_ns <= 2 * NEAR_NS:
            return _between(before, after, stamp_ns)
        near = [one for one in (before, after) if one and abs(one.stamp_ns - stamp_ns) <= NEAR_NS]
        return min(near, key=lambda one: abs(one.stamp_ns - stamp_ns), default=None)


def _between(a: OdometryReading, b: OdometryReading, stamp_ns: int) -> OdometryReading:
    share = (stamp_ns - a.stamp_ns) / (b.stamp_ns - a.stamp_ns)
    R_a, R_b = a.T_odom_child[:3, :3], b.T_odom_child[:3, :3]
    turn, _ = cv2.Rodrigues(R_a.T @ R_b)
    T = np.eye(4)
    T[:3, :3] = R_a @ cv2.Rodrigues(share * turn)[0]
    T[:3, 3] = (1 - share) * a.T_odom_child[:3, 3] + share * b.T_odom_child[:3, 3]
    nearer = a if share < 0.5 else b
    return OdometryReading(stamp_ns, T, nearer.covariance, nearer.child_frame)
