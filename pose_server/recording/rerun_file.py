"""A recording as a file for Rerun (https://rerun.io)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr  # pyright: ignore[reportMissingImports] (large: an extra of its own)

from fleetpose.pose_server.recording.foxglove_scene import FLEET, scaled
from fleetpose.pose_server.recording.show import COLOURS, Floats, Rgb, ShownLink, new_file, rgb
from fleetpose.protocol.messages import Camera, RobotPose


class RerunFile:
    """Writes what is shown into an .rrd file. A robot's camera, image and points hang below its
    body.

    Raises:
        RecordingError: the file is there already, or its folder is not.
    """

    def __init__(self, path: Path) -> None:
        self._stream = rr.RecordingStream("fleetpose")
        self._stream.save(new_file(path))

    def pose(self, said_ns: int, of_ns: int, pose: RobotPose, camera: Camera, colour: Rgb) -> None:
        body = f"{FLEET}/{pose.robot}"
        self._at(said_ns)
        self._stream.log(body, _transform(pose.T_fleet_robot))
        self._stream.log(f"{body}/camera", _transform(camera.T_robot_camera))
        name = rr.Points3D([[0.0, 0.0, 0.0]], colors=[colour], labels=[pose.robot])
        self._stream.log(f"{body}/name", name)

    def lost(self, said_ns: int, robot: str) -> None:
        self._at(said_ns)
        self._stream.log(f"{FLEET}/{robot}", rr.Clear(recursive=True))

    def cloud(self, at_ns: int, robot: str, xyz: Floats) -> None:
        self._at(at_ns)
        points = rr.Points3D(np.asarray(xyz, np.float32))
        self._stream.log(f"{FLEET}/{robot}/camera/points", points)

    def image(self, at_ns: int, robot: str, jpeg: bytes, camera: Camera, scale: int) -> None:
        self._at(at_ns)
        place = f"{FLEET}/{robot}/camera/image"
        size = (camera.width // scale, camera.height // scale)
        self._stream.log(
            place, rr.Pinhole(image_from_camera=scaled(camera.K, scale), resolution=size)
        )
        self._stream.log(place, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))

    def links(self, at_ns: int, links: Sequence[ShownLink]) -> None:
        self._at(at_ns)
        strips = [np.stack((link.a, link.b)) for link in links]
        colours = [rgb(COLOURS[link.verdict]) for link in links]
        self._stream.log(f"{FLEET}/links", rr.LineStrips3D(strips, colors=colours))

    def close(self) -> None:
        self._stream.flush()
        self._stream.disconnect()

    def _at(self, at_ns: int) -> None:
        self._stream.set_time("time", timestamp=np.datetime64(at_ns, "ns"))


def _transform(T: Floats) -> rr.Transform3D:
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
