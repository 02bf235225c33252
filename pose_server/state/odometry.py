"""What robots say of their own motion, between moments of their own clock.

Odometry is absolute in a frame of the robot's own, so that a lost message costs nothing. Of two
moments only the motion between them counts; how sure it is, its covariances do not tell where they
do not grow, so that a share of the motion is added.
"""

from bisect import bisect_left
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import adjoint, inverse, log_so3
from fleetpose.protocol.messages import Odometry, ViewName

Floats = npt.NDArray[np.floating]

KEPT = 256  # of a robot's latest moments
NEAR_S = 0.1  # a view is of a moment that is no farther away
_FLOOR_RAD, _FLOOR_M = np.radians(0.2), 0.002
_SHARE = 0.05  # of the motion


@dataclass(frozen=True, eq=False)
class Moment:
    """Where a robot was by its own odometry: T_odom_robot (4, 4) and its covariance (6, 6), left,
    rotation first.
    """

    stamp_ns: int
    T_odom_robot: Floats
    covariance: Floats


@dataclass
class Odometer:
    """The latest moments of one life of a robot, in order."""

    epoch: str
    _moments: deque[Moment] = field(default_factory=lambda: deque(maxlen=KEPT))

    def note(self, message: Odometry) -> None:
        """Takes a moment; one that is older than the newest is left out."""
        moment = Moment(message.stamp_ns, message.T_odom_robot, message.covariance)
        if not self._moments or self._moments[-1].stamp_ns < moment.stamp_ns:
            self._moments.append(moment)

    def at(self, stamp_ns: int) -> Moment | None:
        """The moment nearest to a stamp, None if none is near."""
        stamps = [moment.stamp_ns for moment in self._moments]
        k = bisect_left(stamps, stamp_ns)
        near = [self._moments[m] for m in (k - 1, k) if 0 <= m < len(stamps)]
        nearest = min(near, key=lambda one: abs(one.stamp_ns - stamp_ns), default=None)
        if nearest is None or abs(nearest.stamp_ns - stamp_ns) > 1e9 * NEAR_S:
            return None
        return nearest


@dataclass
class Odometers:
    """Of all robots. `at` remembers the moments of views as long as these are kept."""

    _robots: dict[str, Odometer] = field(default_factory=dict)
    _of_views: dict[ViewName, Moment] = field(default_factory=dict)

    def note(self, message: Odometry) -> None:
        """Takes a moment of a robot; another life of it begins anew."""
        known = self._robots.get(message.robot)
        if known is None or known.epoch != message.epoch:
            known = self._robots[message.robot] = Odometer(message.epoch)
        known.note(message)

    def clock_went_back(self, robot: str) -> None:
        """A robot's clock was set back: its moments from now on are not late ones of before."""
        self._robots.pop(robot, None)

    def at(self, view: ViewName, stamp_ns: int) -> Moment | None:
        """The moment of a view."""
        if view not in self._of_views:
            known = self._robots.get(view.robot)
            moment = None if known is None or known.epoch != view.epoch else known.at(stamp_ns)
            if moment is None:
                return None
            self._of_views[view] = moment
        return self._of_views[view]

    def forget(self, views: set[ViewName]) -> None:
        """Views that are no longer kept."""
        for view in views:
            self._of_views.pop(view, None)


def camera_motion(
    a: Moment, b: Moment, T_robot_camera_a: Floats, T_robot_camera_b: Floats
) -> tuple[Floats, Floats]:
    """T_a_b of the robot's camera between two moments, and its covariance (6, 6), left."""
    T, covariance = motion(a, b)
    T_camera_robot = inverse(T_robot_camera_a)
    A = adjoint(T_camera_robot)
    return T_camera_robot @ T @ T_robot_camera_b, A @ covariance @ A.T


def motion(a: Moment, b: Moment) -> tuple[Floats, Floats]:
    """T_a_b of the robot's body between two moments, and its covariance (6, 6), left: by how much
    the moments' own covariances grew, and a share of the motion.
    """
    T = inverse(a.T_odom_robot) @ b.T_odom_robot
    A = adjoint(inverse(a.T_odom_robot))
    values, vectors = np.linalg.eigh(A @ (b.covariance - a.covariance) @ A.T)
    grown = (vectors * np.maximum(values, 0.0)) @ vectors.T
    turn = _FLOOR_RAD + _SHARE * float(np.linalg.norm(log_so3(T[:3, :3])))
    shift = _FLOOR_M + _SHARE * float(np.linalg.norm(T[:3, 3]))
    return T, grown + np.diag(np.repeat((turn**2, shift**2), 3))
