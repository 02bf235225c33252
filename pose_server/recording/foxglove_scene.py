"""A site for Foxglove (https://foxglove.dev), in its own schemas: into a file, or to whoever looks.

Frames: `fleet` -> `<robot>` (body) -> `<robot>/camera`. A robot that is not located has none.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer

from fleetpose.pose_server.geometry.se3 import quat_wxyz
from fleetpose.pose_server.recording.show import (
    COLOURS,
    FRUSTUM_EDGES,
    FRUSTUM_M,
    Floats,
    Rgb,
    ShownLink,
    frustum,
    new_file,
    rgb,
)
from fleetpose.protocol.messages import Camera, RobotPose

FLEET = "fleet"
_XYZ = [
    PackedElementField(name=axis, offset=4 * k, type=PackedElementField.FLOAT32)
    for k, axis in enumerate("xyz")
]
_HERE = Pose(orientation=Quaternion(w=1.0))


class Sink(Protocol):
    """Where messages for Foxglove go."""

    def offer(self, topic: str, schema: type[Any]) -> None:
        """Tells that there will be such a topic, before its first message."""
        ...

    def put(self, topic: str, of: str, message: Any, at_ns: int) -> None:
        """Takes a message about a robot or an entity, `of`, at a moment (UTC)."""
        ...

    def close(self) -> None:
        """Nothing more comes."""
        ...


class FileSink:
    """An MCAP file.

    Raises:
        RecordingError: the file is there already, or its folder is not.
    """

    def __init__(self, path: Path) -> None:
        self._file = new_file(path).open("xb")
        # zstd would halve the clouds and leave the images as they are, for 3 ms CPU a view
        self._writer = Writer(self._file, compression=CompressionType.NONE, profile="")

    def offer(self, topic: str, schema: type[Any]) -> None:
        """A file has only topics that something was said under."""

    def put(self, topic: str, of: str, message: Any, at_ns: int) -> None:
        self._writer.write_message(topic, message, at_ns, at_ns)

    def close(self) -> None:
        self._writer.finish()
        self._file.close()


class FoxgloveScene:
    """Says what is shown as messages of Foxglove's."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._drawn: set[str] = set()

    def pose(self, said_ns: int, of_ns: int, pose: RobotPose, camera: Camera, colour: Rgb) -> None:
        robot = pose.robot
        body, eye = _placed(pose.T_fleet_robot), _placed(camera.T_robot_camera)
        at = _stamp(of_ns)
        transforms = FrameTransforms(
            transforms=[
                _transform(at, FLEET, robot, body),
                _transform(at, robot, _camera_frame(robot), eye),
            ]
        )
        self._sink.put("/tf", robot, transforms, said_ns)
        in_fleet = PoseInFrame(timestamp=at, frame_id=FLEET, pose=body)
        self._sink.put(f"/robot/{robot}/pose", robot, in_fleet, said_ns)
        if robot not in self._drawn:
            self._drawn.add(robot)
            entity = _frustum_entity(at, robot, camera, colour)
            self._sink.put("/scene/robots", robot, SceneUpdate(entities=[entity]), said_ns)

    def lost(self, said_ns: int, robot: str) -> None:
        self._drawn.discard(robot)
        gone = SceneEntityDeletion(
            timestamp=_stamp(said_ns), type=SceneEntityDeletion.MATCHING_ID, id=robot
        )
        self._sink.put("/scene/robots", robot, SceneUpdate(deletions=[gone]), said_ns)

    def cloud(self, at_ns: int, robot: str, xyz: Floats) -> None:
        message = PointCloud(
            timestamp=_stamp(at_ns),
            frame_id=_camera_frame(robot),
            pose=_HERE,
            point_stride=12,
            fields=_XYZ,
            data=np.ascontiguousarray(xyz, "<f4").tobytes(),
        )
        self._sink.offer(image_topic(robot), CompressedImage)
        self._sink.put(f"/robot/{robot}/points", robot, message, at_ns)

    def image(self, at_ns: int, robot: str, jpeg: bytes, camera: Camera, scale: int) -> None:
        at, frame = _stamp(at_ns), _camera_frame(robot)
        message = CompressedImage(timestamp=at, frame_id=frame, data=jpeg, format="jpeg")
        self._sink.put(image_topic(robot), robot, message, at_ns)
        K = scaled(camera.K, scale)
        calibration = CameraCalibration(
            timestamp=at,
            frame_id=frame,
            width=camera.width // scale,
            height=camera.height // scale,
            K=K.ravel().tolist(),
            R=np.eye(3).ravel().tolist(),
            P=np.column_stack((K, np.zeros(3))).ravel().tolist(),
        )
        self._sink.put(f"/robot/{robot}/calibration", robot, calibration, at_ns)

    def links(self, at_ns: int, links: Sequence[ShownLink]) -> None:
        ends = [end for link in links for end in (link.a, link.b)]
        colours = [_colour(rgb(COLOURS[link.verdict])) for link in links for _ in range(2)]
        lines = _lines(ends, 2.0, colors=colours)
        entity = SceneEntity(timestamp=_stamp(at_ns), frame_id=FLEET, id="links", lines=[lines])
        self._sink.put("/scene/links", "links", SceneUpdate(entities=[entity]), at_ns)

    def close(self) -> None:
        self._sink.close()


def scaled(K: Floats, scale: int) -> Floats:
    """Intrinsics of an image of which one pixel is `scale` of the camera's; the first one's centre
    is at 0 in both.
    """
    small = K / scale
    small[:2, 2] += 0.5 / scale - 0.5
    small[2, 2] = 1.0
    return small


def image_topic(robot: str) -> str:
    """Under which a robot's images come."""
    return f"/robot/{robot}/image"


def _camera_frame(robot: str) -> str:
    return f"{robot}/camera"


def _stamp(at_ns: int) -> Timestamp:
    return Timestamp(seconds=at_ns // 10**9, nanos=at_ns % 10**9)


def _placed(T: Floats) -> Pose:
    w, x, y, z = quat_wxyz(T[:3, :3])
    x_m, y_m, z_m = T[:3, 3]
    return Pose(position=Vector3(x=x_m, y=y_m, z=z_m), orientation=Quaternion(x=x, y=y, z=z, w=w))


def _transform(at: Timestamp, parent: str, child: str, pose: Pose) -> FrameTransform:
    return FrameTransform(
        timestamp=at,
        parent_frame_id=parent,
        child_frame_id=child,
        translation=pose.position,
        rotation=pose.orientation,
    )


def _frustum_entity(at: Timestamp, robot: str, camera: Camera, colour: Rgb) -> SceneEntity:
    corners = frustum(camera, FRUSTUM_M)
    ends = [corners[k] for edge in FRUSTUM_EDGES for k in edge]
    name = TextPrimitive(
        pose=_HERE,
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=_colour(colour),
        text=robot,
    )
    return SceneEntity(
        timestamp=at,
        frame_id=_camera_frame(robot),
        id=robot,
        frame_locked=True,
        lines=[_lines(ends, 1.5, color=_colour(colour))],
        texts=[name],
    )


def _lines(ends: Iterable[Floats], thickness: float, **colours: Any) -> LinePrimitive:
    """Lines between each two points in a row, as thick on the screen as told."""
    return LinePrimitive(
        type=LinePrimitive.LINE_LIST,
        pose=_HERE,
        thickness=thickness,
        scale_invariant=True,
        points=[Point3(x=x, y=y, z=z) for x, y, z in ends],
        **colours,
    )


def _colour(colour: Rgb) -> Color:
    red, green, blue = (part / 255.0 for part in colour)
    return Color(r=red, g=green, b=blue, a=1.0)
