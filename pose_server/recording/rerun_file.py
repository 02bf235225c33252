"""A recording as a file for Rerun (https://rerun.io)."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr  # pyright: ignore[reportMissingImports] (large: an extra of its own)
import rerun.blueprint as rrb  # pyright: ignore[reportMissingImports]

from fleetpose.pose_server.recording.foxglove_scene import FLEET, scaled
from fleetpose.pose_server.recording.show import (
    COLOURS,
    FRUSTUM_M,
    Floats,
    Rgb,
    ShownLink,
    new_file,
    rgb,
)
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
        self._robots: set[str] = set()
        self._colours: dict[str, Rgb] = {}
        self._stream.log(FLEET, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)

    def pose(self, said_ns: int, of_ns: int, pose: RobotPose, camera: Camera, colour: Rgb) -> None:
        body = f"{FLEET}/{pose.robot}"
        self._colours[pose.robot] = colour
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
        colours = self._colours.get(robot)  # none before its first pose: it is nowhere then
        points = rr.Points3D(np.asarray(xyz, np.float32), colors=colours)
        self._stream.log(f"{FLEET}/{robot}/camera/points", points)

    def image(self, at_ns: int, robot: str, jpeg: bytes, camera: Camera, scale: int) -> None:
        self._at(at_ns)
        self._robots.add(robot)
        place = _image(robot)
        self._stream.log(
            place,
            rr.Pinhole(
                image_from_camera=scaled(camera.K, scale),
                resolution=(camera.width // scale, camera.height // scale),
                image_plane_distance=FRUSTUM_M,
            ),
        )
        self._stream.log(place, rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))

    def links(self, at_ns: int, links: Sequence[ShownLink]) -> None:
        self._at(at_ns)
        strips = [np.stack((link.a, link.b)) for link in links]
        colours = [rgb(COLOURS[link.verdict]) for link in links]
        self._stream.log(f"{FLEET}/links", rr.LineStrips3D(strips, colors=colours))

    def close(self) -> None:
        self._stream.send_blueprint(self._arranged())
        self._stream.flush()
        self._stream.disconnect()

    def _arranged(self) -> rrb.Blueprint:
        """The fleet in 3D beside the robots' images, at the end of the recording."""
        fleet = rrb.Spatial3DView(origin=FLEET, name="fleet")
        images = [rrb.Spatial2DView(origin=_image(one), name=one) for one in sorted(self._robots)]
        parts = rrb.Horizontal(fleet, rrb.Grid(*images), column_shares=[2, 1]) if images else fleet
        follow = rrb.TimePanel(timeline="time", play_state="following", state="collapsed")
        return rrb.Blueprint(parts, follow, collapse_panels=True)

    def _at(self, at_ns: int) -> None:
        self._stream.set_time("time", timestamp=np.datetime64(at_ns, "ns"))


def _image(robot: str) -> str:
    return f"{FLEET}/{robot}/camera/image"


def _transform(T: Floats) -> rr.Transform3D:
    return rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
