"""Messages of ROS 2 as a robot's drivers fill them in."""

import struct
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, quat_wxyz
from fleetpose.rosmsg.dialects import rmw_zenoh

STAMP_AT, TRANSFORM_STAMP_AT = 4, 8
"""Where a coded message has its stamp, and a tf message that of its first transform."""


def of(of_type: str, /, **fields: Any) -> Any:
    """A message of a type, `sensor_msgs/Image`."""
    package, _, name = of_type.partition("/")
    return rmw_zenoh.types().types[f"{package}/msg/{name}"](**fields)


def coded(message: Any) -> bytearray:
    """Its CDR, in which stamps can be written anew."""
    return bytearray(rmw_zenoh.types().serialize_cdr(message, message.__msgtype__))


def stamp(raw: bytearray, stamp_ns: int, at: int = STAMP_AT) -> None:
    """Writes a stamp (UTC, ns) into a coded message."""
    struct.pack_into("<iI", raw, at, *divmod(stamp_ns, 10**9))


def header(frame: str) -> Any:
    """Of a message that is stamped later."""
    return of(
        "std_msgs/Header", stamp=of("builtin_interfaces/Time", sec=0, nanosec=0), frame_id=frame
    )


def image(array: npt.NDArray[Any], encoding: str, frame: str) -> Any:
    """`sensor_msgs/Image` of (H, W) or (H, W, C)."""
    rows = np.ascontiguousarray(array).view(np.uint8).reshape(array.shape[0], -1)
    return of(
        "sensor_msgs/Image",
        header=header(frame),
        height=array.shape[0],
        width=array.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def info(K: Floats, size: tuple[int, int], frame: str) -> Any:
    """`sensor_msgs/CameraInfo` of a camera without distortion."""
    corner = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
    return of(
        "sensor_msgs/CameraInfo",
        header=header(frame),
        height=size[1],
        width=size[0],
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=K.reshape(-1),
        r=np.eye(3).reshape(-1),
        p=np.hstack((K, np.zeros((3, 1)))).reshape(-1),
        binning_x=0,
        binning_y=0,
        roi=of("sensor_msgs/RegionOfInterest", **corner, do_rectify=False),
    )


def transforms(*edges: tuple[str, str, Floats]) -> Any:
    """`tf2_msgs/TFMessage` of (parent, child, T_parent_child) each."""
    return of("tf2_msgs/TFMessage", transforms=[_edge(*edge) for edge in edges])


def odometry(T_odom_base: Floats, frame: str, child: str) -> Any:
    """`nav_msgs/Odometry`, 1 cm and 0.5 deg sure."""
    sure = np.diag([0.01**2] * 3 + [np.radians(0.5) ** 2] * 3)
    return of(
        "nav_msgs/Odometry",
        header=header(frame),
        child_frame_id=child,
        pose=of(
            "geometry_msgs/PoseWithCovariance", pose=_pose(T_odom_base), covariance=sure.reshape(-1)
        ),
        twist=of(
            "geometry_msgs/TwistWithCovariance",
            twist=of(
                "geometry_msgs/Twist", linear=_vector(np.zeros(3)), angular=_vector(np.zeros(3))
            ),
            covariance=np.zeros(36),
        ),
    )


def imu(acceleration: Floats, frame: str, turning: Floats | None = None) -> Any:
    """`sensor_msgs/Imu`: what its accelerometer (m/s2) and gyroscope (rad/s) say."""
    return of(
        "sensor_msgs/Imu",
        header=header(frame),
        orientation=of("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=np.array([-1.0, *[0.0] * 8]),
        angular_velocity=_vector(np.zeros(3) if turning is None else turning),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=_vector(acceleration),
        linear_acceleration_covariance=np.zeros(9),
    )


def _edge(parent: str, child: str, T: Floats) -> Any:
    transform = of(
        "geometry_msgs/Transform", translation=_vector(T[:3, 3]), rotation=_quaternion(T)
    )
    return of(
        "geometry_msgs/TransformStamped",
        header=header(parent),
        child_frame_id=child,
        transform=transform,
    )


def _pose(T: Floats) -> Any:
    x, y, z = map(float, T[:3, 3])
    position = of("geometry_msgs/Point", x=x, y=y, z=z)
    return of("geometry_msgs/Pose", position=position, orientation=_quaternion(T))


def _vector(xyz: Floats) -> Any:
    x, y, z = map(float, xyz)
    return of("geometry_msgs/Vector3", x=x, y=y, z=z)


def _quaternion(T: Floats) -> Any:
    w, x, y, z = map(float, quat_wxyz(T[:3, :3]))
    return of("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)
