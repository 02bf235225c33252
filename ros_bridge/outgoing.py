"""Messages of ROS as they are made here: frames, poses and odometry of the fleet."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Types = Callable[[str], Any]
"""Gives the class of a message by its type, e.g. `geometry_msgs/msg/Point`: rclpy's, or ours."""

_UNKNOWN = -1.0  # at the head of a covariance: sensor_msgs' word for not known


def ros_covariance(covariance: Floats, T: Floats) -> Floats:
    """(36,) as ROS has it, position first, then rotation about fixed axes at the robot, of a left
    perturbation, rotation first: dp = rho - p x phi.

    Args:
        covariance: (6, 6).
        T: (4, 4) the pose.
    """
    x, y, z = T[:3, 3]
    J = np.zeros((6, 6))
    J[:3, 3:] = J[3:, :3] = np.eye(3)
    J[:3, :3] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]
    return (J @ covariance @ J.T).reshape(36)


def quaternion(R: Floats) -> Floats:
    """(4,) x y z w, w >= 0, of a rotation (3, 3): the eigenvector of Bar-Itzhack's matrix, which is
    exact to rounding for every angle (J. Guidance 23(6), 2000).
    """
    a, b, c = R
    K = np.array(
        [
            [a[0] - b[1] - c[2], b[0] + a[1], c[0] + a[2], c[1] - b[2]],
            [b[0] + a[1], b[1] - a[0] - c[2], c[1] + b[2], a[2] - c[0]],
            [c[0] + a[2], c[1] + b[2], c[2] - a[0] - b[1], b[0] - a[1]],
            [c[1] - b[2], a[2] - c[0], b[0] - a[1], a[0] + b[1] + c[2]],
        ]
    )
    q = np.linalg.eigh(K).eigenvectors[:, -1]
    return q if q[3] >= 0 else -q


class Outgoing:
    """Makes messages.

    Args:
        types: of the library that sends them.
    """

    def __init__(self, types: Types) -> None:
        self._types = types

    def transform(self, parent: str, child: str, T: Floats, stamp_ns: int) -> Any:
        """`TransformStamped`: where a frame stands in its parent."""
        x, y, z = map(float, T[:3, 3])
        moved = self._types("geometry_msgs/msg/Transform")(
            translation=self._types("geometry_msgs/msg/Vector3")(x=x, y=y, z=z),
            rotation=self._rotation(T),
        )
        return self._types("geometry_msgs/msg/TransformStamped")(
            header=self._header(parent, stamp_ns), child_frame_id=child, transform=moved
        )

    def transforms(self, transforms: Sequence[Any]) -> Any:
        """`TFMessage`."""
        return self._types("tf2_msgs/msg/TFMessage")(transforms=list(transforms))

    def pose(self, frame: str, T: Floats, covariance: Floats, stamp_ns: int) -> Any:
        """`PoseWithCovarianceStamped`; the covariance is a left perturbation, rotation first."""
        return self._types("geometry_msgs/msg/PoseWithCovarianceStamped")(
            header=self._header(frame, stamp_ns), pose=self._pose(T, covariance)
        )

    def odometry(self, frame: str, child: str, T: Floats, covariance: Floats, stamp_ns: int) -> Any:
        """`Odometry` whose twist is not known."""
        still = self._types("geometry_msgs/msg/Vector3")
        twist = self._types("geometry_msgs/msg/Twist")(
            linear=still(x=0.0, y=0.0, z=0.0), angular=still(x=0.0, y=0.0, z=0.0)
        )
        unknown = np.zeros(36)
        unknown[0] = _UNKNOWN
        return self._types("nav_msgs/msg/Odometry")(
            header=self._header(frame, stamp_ns),
            child_frame_id=child,
            pose=self._pose(T, covariance),
            twist=self._types("geometry_msgs/msg/TwistWithCovariance")(
                twist=twist, covariance=unknown
            ),
        )

    def _pose(self, T: Floats, covariance: Floats) -> Any:
        x, y, z = map(float, T[:3, 3])
        pose = self._types("geometry_msgs/msg/Pose")(
            position=self._types("geometry_msgs/msg/Point")(x=x, y=y, z=z),
            orientation=self._rotation(T),
        )
        return self._types("geometry_msgs/msg/PoseWithCovariance")(
            pose=pose, covariance=ros_covariance(covariance, T)
        )

    def _rotation(self, T: Floats) -> Any:
        x, y, z, w = map(float, quaternion(np.asarray(T[:3, :3], np.float64)))
        return self._types("geometry_msgs/msg/Quaternion")(x=x, y=y, z=z, w=w)

    def _header(self, frame: str, stamp_ns: int) -> Any:
        seconds, nanoseconds = divmod(int(stamp_ns), 10**9)
        return self._types("std_msgs/msg/Header")(
            stamp=self._types("builtin_interfaces/msg/Time")(sec=seconds, nanosec=nanoseconds),
            frame_id=frame,
        )
