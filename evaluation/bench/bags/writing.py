"""Writes bags without ROS: images, depths, infos and true poses, as mcap, sqlite3 or ROS 1."""

from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from fleetpose.evaluation.metrics.geometry import Floats, quat_wxyz

Storage = Literal["mcap", "sqlite3", "ros1"]
ZSTD = (CompressionMode.MESSAGE, CompressionFormat.ZSTD)


class BagWriter:
    """One bag that is being written.

    Args:
        path: folder of a rosbag2, or file of a ROS 1 bag.
        storage: what it is kept in.
        packed: whether each message is packed by zstd (not in ROS 1).
    """

    def __init__(self, path: Path, storage: Storage, packed: bool = False) -> None:
        self._ros1 = storage == "ros1"
        stores = Stores.ROS1_NOETIC if self._ros1 else Stores.ROS2_HUMBLE
        self._store = get_typestore(stores)
        if self._ros1:
            self._writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
            self._writer = Writer2(path, version=9, storage_plugin=plugin)
        if packed:
            self._writer.set_compression(*ZSTD)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Self:
        self._writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.close()

    def put(self, topic: str, message: Any, at_ns: int) -> None:
        """Writes a message as recorded at a time."""
        kind = message.__msgtype__
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, kind, typestore=self._store
            )
        coded = self._store.serialize_ros1 if self._ros1 else self._store.serialize_cdr
        self._writer.write(self._connections[topic], at_ns, coded(message, kind))

    def image(self, topic: str, array: npt.NDArray[Any], encoding: str, at_ns: int) -> None:
        """An Image of an array (H, W) or (H, W, 3)."""
        rows = np.ascontiguousarray(array).view(np.uint8).reshape(array.shape[0], -1)
        message = self._of(
            "sensor_msgs/msg/Image",
            header=self._header(at_ns),
            height=array.shape[0],
            width=array.shape[1],
            encoding=encoding,
            is_bigendian=0,
            step=rows.shape[1],
            data=rows.reshape(-1),
        )
        self.put(topic, message, at_ns)

    def packed_image(self, topic: str, data: bytes, form: str, at_ns: int) -> None:
        """A CompressedImage."""
        packed = {"format": form, "data": np.frombuffer(data, np.uint8)}
        kind = "sensor_msgs/msg/CompressedImage"
        self.put(topic, self._of(kind, header=self._header(at_ns), **packed), at_ns)

    def info(self, topic: str, K: Floats, size: tuple[int, int], at_ns: int) -> None:
        """CameraInfo of a camera without distortion; size: width, height, px."""
        P = np.hstack((K, np.zeros((3, 1))))
        numbers = {"d": np.zeros(5), "k": K.reshape(-1), "r": np.eye(3).reshape(-1)}
        numbers["p"] = P.reshape(-1)
        if self._ros1:
            numbers = {name.upper(): value for name, value in numbers.items()}
        corners = dict.fromkeys(("x_offset", "y_offset", "height", "width"), 0)
        message = self._of(
            "sensor_msgs/msg/CameraInfo",
            header=self._header(at_ns),
            height=size[1],
            width=size[0],
            distortion_model="plumb_bob",
            binning_x=0,
            binning_y=0,
            roi=self._of("sensor_msgs/msg/RegionOfInterest", **corners, do_rectify=False),
            **numbers,
        )
        self.put(topic, message, at_ns)

    def pose(self, topic: str, T_world_camera: Floats, at_ns: int) -> None:
        """PoseStamped: where the camera truly is."""
        w, x, y, z = map(float, quat_wxyz(T_world_camera[:3, :3]))
        place = dict(zip("xyz", map(float, T_world_camera[:3, 3]), strict=True))
        pose = self._of(
            "geometry_msgs/msg/Pose",
            position=self._of("geometry_msgs/msg/Point", **place),
            orientation=self._of("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )
        kind = "geometry_msgs/msg/PoseStamped"
        self.put(topic, self._of(kind, header=self._header(at_ns, "world"), pose=pose), at_ns)

    def _of(self, kind: str, **fields: Any) -> Any:
        return self._store.types[kind](**fields)

    def _header(self, at_ns: int, frame: str = "camera_color_optical_frame") -> Any:
        seconds, rest = divmod(at_ns, 10**9)
        stamp = self._of("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
        more = {"seq": 0} if self._ros1 else {}
        return self._of("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)
