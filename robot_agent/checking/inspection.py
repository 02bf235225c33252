"""`robot-agent inspect`: what a folder, a file or a device is, what is understood of it, and the
command that runs it.
"""

import itertools
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import Camera, Frame, OtherKindError
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.kinds import CameraKind
from fleetpose.robot_agent.cameras.stereo.video import is_device
from fleetpose.robot_agent.cameras.understood import Understood, understood_of
from fleetpose.robot_agent.checking.told import Told
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.rosmsg import METADATA, is_bag

_OF_FOLDERS: tuple[CameraKind, ...] = ("stereo", "rgbd", "views", "reconstruction", "cloud")
_OF_FILES: tuple[CameraKind, ...] = ("cloud", "reconstruction", "stereo")
_WHAT = {
    "stereo": "a stereo camera",
    "rgbd": "an RGB-D recording",
    "views": "posed views",
    "reconstruction": "a reconstruction",
    "cloud": "scans without images",
    "bag": "a bag",
}
_FEW_POINTS = 100  # salient points with depth, of which the aligner still makes something


@dataclass(frozen=True)
class Inspection:
    """What was found.

    Attributes:
        kind: of the camera.
        told: what its readers said while they opened it.
        understood: by its first frame.
        keypoints: how many of its first frame have depth.
        command: runs it.
    """

    kind: CameraKind
    understood: Understood
    keypoints: int
    command: str
    told: list[str] = field(default_factory=list)

    def lines(self, source: str) -> Iterator[str]:
        """One screen."""
        yield f"{source} is {_WHAT[self.kind]} (--camera {self.kind})"
        yield f"  understood  {self.understood}"
        if self.kind != "cloud":
            yield f"  keypoints   {self.keypoints} have depth"
        for told in self.told:
            yield f"  note        {told}"
        few = self.kind != "cloud" and self.keypoints < _FEW_POINTS
        if self.understood.is_thin or few:
            yield (
                "  warning     with so little depth it will hardly be aligned: is a lens dark or "
                "covered, is there texture, does the calibration fit (robot-agent calibrate-check)?"
            )
        yield f"  run it      {self.command}"


def inspect(
    source: str,
    calibration: Path | None = None,
    translation_unit: float | None = None,
    depth_scale: float | None = None,
    clouds: str | None = None,
) -> Inspection:
    """Opens a source as each kind of camera in turn, until one can be.

    Raises:
        FleetPoseError: it is of no known kind, or of one whose calibration cannot be used; the
            sentence says what to do.
    """
    path = Path(source)
    stream = is_device(source) or not path.exists()
    kinds = ("stereo",) if stream else _kinds_of(path)
    options = {
        "calibration": calibration,
        "translation_unit": translation_unit,
        "depth_scale": depth_scale,
        "clouds": clouds,
    }
    refusals: list[str] = []
    with Told() as told:
        for kind in kinds:
            told.lines.clear()
            try:
                camera = open_camera(kind, source, "once", **options)
                frame = _first_frame(camera)
                if kind == "bag":
                    told.lines[:0] = _roles_of(camera)
            except OtherKindError as error:
                refusals.append(f"{kind}: {str(error).removeprefix(source).lstrip()}")
                continue
            return _inspection(kind, source, frame, options, told.lines)
    raise DataFolderError(f"{source} is of no kind that is known:\n  " + "\n  ".join(refusals))


def _kinds_of(path: Path) -> tuple[CameraKind, ...]:
    if not is_bag(path):
        return _OF_FOLDERS if path.is_dir() else _OF_FILES
    return ("bag",) if path.is_file() or (path / METADATA).is_file() else (*_OF_FOLDERS, "bag")


def _roles_of(camera: Camera) -> list[str]:
    from fleetpose.robot_agent.cameras.bag.camera import BagCamera
    from fleetpose.rosmsg.roles import missing

    assert isinstance(camera, BagCamera)
    roles = camera.recording.roles
    taken = ", ".join(f"{role} {topic}" for role, topic in roles.names.items() if topic)
    return [f"{taken} (robot-agent topics says why)", *missing(roles)]


def _first_frame(camera: Camera) -> Frame:
    try:
        for frame in itertools.islice(camera.frames(), 1):
            return frame
    finally:
        camera.close()
    raise DataFolderError("it has no frame")


def _inspection(
    kind: CameraKind, source: str, frame: Frame, options: dict, told: list[str]
) -> Inspection:
    given = [
        f"--{name.replace('_', '-')} {shlex.quote(str(value))}"
        for name, value in options.items()
        if value is not None
    ]
    command = ["robot-agent run --name r1", f"--camera {kind} --data {shlex.quote(source)}", *given]
    return Inspection(
        kind, understood_of(frame), len(salient_of(frame).uv), " ".join(command), list(told)
    )
