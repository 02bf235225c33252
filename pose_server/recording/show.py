"""A site as another viewer shows it, recorded or as it is: what is said is opened in order and
handed to a `Viewer`.

Moments are those at which a view arrived, by the clock of who recorded: robots' clocks, which may
be off, show nothing at the wrong place.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.messages import (
    Camera,
    CameraAnnouncement,
    FleetState,
    ImageHeader,
    RobotPose,
    View,
    ViewName,
)
from fleetpose.protocol.recording.file import Record, Recording, RecordingError
from fleetpose.protocol.transport import ENCODING_JPEG

Floats = npt.NDArray[np.floating]
MAX_POINTS = 20_000
"""Of a cloud: viewers draw clouds of a whole fleet beside each other."""
COLOURS = {"verified": "#00694d", "plausible": "#8a5a00", "ambiguous": "#a33c00"}
"""Of links, as in the map's picture."""
Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class ShownLink:
    """Two robots that were aligned: where both are in the fleet's frame (3,), and how sure."""

    a: Floats
    b: Floats
    verdict: str


class Viewer(Protocol):
    """What a site is shown in. Moments are nanoseconds, UTC."""

    def pose(self, said_ns: int, of_ns: int, pose: RobotPose, camera: Camera, colour: Rgb) -> None:
        """A located robot's pose at the moment of its view."""
        ...

    def lost(self, said_ns: int, robot: str) -> None:
        """A robot is not located any more."""
        ...

    def cloud(self, at_ns: int, robot: str, xyz: Floats) -> None:
        """Points (N, 3) in the camera frame of a robot."""
        ...

    def image(self, at_ns: int, robot: str, jpeg: bytes, camera: Camera, scale: int) -> None:
        """An image of a robot, `scale` pixels of the camera to one of it."""
        ...

    def links(self, at_ns: int, links: Sequence[ShownLink]) -> None:
        """All links of the fleet."""
        ...

    def close(self) -> None:
        """Ends the file."""
        ...


@dataclass
class Counted:
    """What was shown.

    Attributes:
        damaged: messages that could not be opened.
        opening_ms, showing_ms: CPU of all views, to open what was said and to show it.
    """

    clouds: int = 0
    images: int = 0
    poses: int = 0
    damaged: int = 0
    opening_ms: float = 0.0
    showing_ms: float = 0.0

    def __str__(self) -> str:
        each = max(self.clouds, 1)
        damaged = f", {self.damaged} messages could not be opened" if self.damaged else ""
        return (
            f"{self.clouds} views, {self.images} images, {self.poses} poses{damaged}; a view: "
            f"{self.opening_ms / each:.1f} ms CPU to open, {self.showing_ms / each:.1f} ms to write"
        )


@dataclass
class Show:
    """Shows one site in one viewer."""

    viewer: Viewer
    count: Counted = field(default_factory=Counted)
    _cameras: dict[str, Camera] = field(default_factory=dict)
    _arrived_ns: dict[ViewName, int] = field(default_factory=dict)
    _colours: dict[str, Rgb] = field(default_factory=dict)
    _located: set[str] = field(default_factory=set)
    _linked: object = None

    def take(self, record: Record) -> None:
        """Shows one record, if it is to be seen."""
        if record.way != "in":
            return
        try:
            match record.sample.encoding:
                case encoding if encoding == encoding_of(View):
                    self._view(record)
                case encoding if encoding == encoding_of(CameraAnnouncement):
                    announced = unpack(CameraAnnouncement, record.sample.payload)
                    self._cameras.setdefault(announced.robot, announced.camera)
                case encoding if encoding == encoding_of(RobotPose):
                    self._pose(record)
                case encoding if encoding == encoding_of(FleetState):
                    self._state(record)
                case encoding if encoding == ENCODING_JPEG:
                    self._image(record)
                case _:
                    pass
        except FleetPoseError:
            self.count.damaged += 1

    def _view(self, record: Record) -> None:
        with self._opening():
            view = unpack(View, record.sample.payload)
            points = points_of(view, MAX_POINTS)
        robot = view.name.robot
        self._cameras[robot] = view.camera
        self._arrived_ns[view.name] = record.at_ns
        self.count.clouds += 1
        with self._showing():
            self.viewer.cloud(record.at_ns, robot, points.xyz)

    def _image(self, record: Record) -> None:
        with self._opening():
            if record.sample.attachment is None:
                raise CodecError("an image without header")
            header = unpack(ImageHeader, record.sample.attachment)
        robot = header.view.robot
        camera, at_ns = self._cameras.get(robot), self._arrived_ns.get(header.view)
        if camera is None:
            return
        self.count.images += 1
        with self._showing():
            jpeg = record.sample.payload
            self.viewer.image(at_ns or record.at_ns, robot, jpeg, camera, header.scale)

    def _pose(self, record: Record) -> None:
        with self._opening():
            pose = unpack(RobotPose, record.sample.payload)
        camera = self._cameras.get(pose.robot)
        with self._showing():
            if not pose.located:
                self._lose({pose.robot} & self._located, record.at_ns)
            elif camera is not None:
                self.count.poses += 1
                self._located.add(pose.robot)
                of_ns = self._arrived_ns.get(pose.view, record.at_ns)
                self.viewer.pose(record.at_ns, of_ns, pose, camera, self._colour(pose.robot))

    def _state(self, record: Record) -> None:
        with self._opening():
            state = unpack(FleetState, record.sample.payload)
        with self._showing():
            at = {
                one.robot: one.pose.T_fleet_robot[:3, 3]
                for one in state.robots
                if one.pose is not None and one.pose.located
            }
            self._lose(self._located - at.keys(), record.at_ns)
            links = [
                ShownLink(at[cell.i], at[cell.j], cell.verdict)
                for cell in state.pairs
                if cell.verdict in COLOURS and cell.i in at and cell.j in at
            ]
            said = [(link.a.tobytes(), link.b.tobytes(), link.verdict) for link in links]
            if said != self._linked:
                self._linked = said
                self.viewer.links(record.at_ns, links)

    def _lose(self, robots: set[str], at_ns: int) -> None:
        for robot in sorted(robots):
            self._located.discard(robot)
            self.viewer.lost(at_ns, robot)

    def _colour(self, robot: str) -> Rgb:
        if robot not in self._colours:
            from fleetpose.pose_server.mapping.colours import robot_colours

            # the k-th robot keeps its colour however many come after it, up to ten of them
            row = robot_colours(len(self._colours) + 1)[-1]
            self._colours[robot] = (int(row[0]), int(row[1]), int(row[2]))
        return self._colours[robot]

    @contextmanager
    def _opening(self) -> Iterator[None]:
        began = time.process_time()
        try:
            yield
        finally:
            self.count.opening_ms += 1e3 * (time.process_time() - began)

    @contextmanager
    def _showing(self) -> Iterator[None]:
        began = time.process_time()
        yield
        self.count.showing_ms += 1e3 * (time.process_time() - began)


def show(recording: Recording, viewer: Viewer) -> Counted:
    """Shows a recording from its beginning to its end.

    Raises:
        RecordingError: the recording cannot be read, or the viewer's file not be written.
    """
    shown = Show(viewer)
    try:
        for record in recording:
            shown.take(record)
        with shown._showing():
            viewer.close()
    except OSError as error:
        raise RecordingError(f"the viewer's file ends too early: {error.strerror}") from error
    return shown.count


def new_file(path: Path) -> Path:
    """A file that may be written.

    Raises:
        RecordingError: it is there already, or its folder is not.
    """
    if path.exists():
        raise RecordingError(f"{path} is there already: name another file")
    if not path.absolute().parent.is_dir():
        raise RecordingError(f"{path} cannot be written: its folder is not there")
    return path


def rgb(colour: str) -> Rgb:
    """Of `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def frustum(camera: Camera, depth_m: float) -> Floats:
    """(5, 3) eye and the image's corners at a depth, in the camera frame."""
    w, h = camera.width, camera.height
    pixels = np.array([[0, 0, 1], [w, 0, 1], [w, h, 1], [0, h, 1]], float)
    rays = pixels @ np.linalg.inv(camera.K).T
    return np.vstack((np.zeros(3), depth_m * rays))


FRUSTUM_EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))
FRUSTUM_M = 0.4
