"""A calibrated stereo pair, and reading it from files: our JSON, OpenCV's, Kalibr's.

Conventions are those of `cv2.stereoCalibrate`: `R` and `t` map points of the left camera to the
right one, `x_right = R x_left + t`, t in metres, so the first coordinate of t is minus the
baseline. Images are given unrectified with their distortion, or rectified with none.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.robot_agent.cameras.folders.files import read_json
from fleetpose.robot_agent.cameras.stereo import kalibr

Floats = npt.NDArray[np.float64]

MAX_BASELINE_M = 5.0
RIG_FILES = ("stereo.json", "stereo.yml", "stereo.yaml", "stereo.xml", "camchain.yaml")
# our name, then those of OpenCV's samples and of common tools
_NAMES = {
    "K_left": ("K_left", "K1", "M1", "cameraMatrix1"),
    "D_left": ("D_left", "D1", "distCoeffs1"),
    "K_right": ("K_right", "K2", "M2", "cameraMatrix2"),
    "D_right": ("D_right", "D2", "distCoeffs2"),
    "R": ("R",),
    "t": ("t", "T"),
    "width": ("width", "image_width"),
    "height": ("height", "image_height"),
}


@dataclass(frozen=True)
class StereoRig:
    """Two cameras fixed to each other.

    Attributes:
        K_left, K_right: (3, 3) pinhole intrinsics, px.
        D_left, D_right: distortion, OpenCV's 4, 5, 8, 12 or 14 coefficients; zeros for none.
        T_right_left: (4, 4) points of the left camera to the right one, metres.
        size: width, height of both images, px.
        T_robot_left: (4, 4) where the left camera sits on the robot.

    Raises:
        CalibrationError: such a rig cannot be; the sentence says what to fix.
    """

    K_left: Floats
    D_left: Floats
    K_right: Floats
    D_right: Floats
    T_right_left: Floats
    size: tuple[int, int]
    T_robot_left: Floats = field(default_factory=lambda: ROBOT_FROM_CAMERA.copy())

    def __post_init__(self) -> None:
        for name in ("K_left", "K_right"):
            _check_pinhole(name, getattr(self, name), self.size)
        for name in ("D_left", "D_right"):
            D = getattr(self, name)
            if D.size not in (4, 5, 8, 12, 14) or not np.isfinite(D).all():
                raise CalibrationError(
                    f"{name} has {D.size} numbers: give 4, 5, 8, 12 or 14, zeros for none"
                )
        for name in ("T_right_left", "T_robot_left"):
            _check_rigid(name, getattr(self, name))
        _check_baseline(self.T_right_left[:3, 3])

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras."""
        return float(np.linalg.norm(self.T_right_left[:3, 3]))

    @property
    def is_rectified(self) -> bool:
        """Whether the images need no rectification."""
        T = self.T_right_left
        sideways = np.eye(4)
        sideways[0, 3] = T[0, 3]
        undistorted = not self.D_left.any() and not self.D_right.any()
        return (
            undistorted
            and np.array_equal(self.K_left, self.K_right)
            and np.allclose(T, sideways, atol=1e-9)
        )


def rig_of(
    content: Mapping[str, Any], where: str, size: tuple[int, int] | None = None
) -> StereoRig:
    """A rig from named matrices.

    Args:
        content: K_left, D_left, K_right, D_right, R, t, or OpenCV's names for them; optionally
            width and height, and T_robot_left (4, 4). Distortion may be left out where there
            is none.
        where: what to call the source in errors.
        size: of the images, used where the content does not say it.

    Raises:
        CalibrationError: something is missing or impossible.
    """
    found = {name: _first(content, aliases) for name, aliases in _NAMES.items()}
    missing = [name for name in ("K_left", "K_right", "R", "t") if found[name] is None]
    if missing:
        raise CalibrationError(f"{where} lacks {', '.join(missing)}")
    T_right_left, T_robot_left = np.eye(4), ROBOT_FROM_CAMERA
    try:
        T_right_left[:3, :3] = _rotation(_array(found["R"]))
        T_right_left[:3, 3] = _array(found["t"]).reshape(3)
        if "T_robot_left" in content:
            T_robot_left = _array(content["T_robot_left"]).reshape(4, 4)
        if found["width"] is not None and found["height"] is not None:
            size = int(found["width"]), int(found["height"])
        if size is None:
            raise CalibrationError(f"{where} lacks width and height of the images")
        return StereoRig(
            _array(found["K_left"]).reshape(3, 3),
            _array([0.0] * 5 if found["D_left"] is None else found["D_left"]).reshape(-1),
            _array(found["K_right"]).reshape(3, 3),
            _array([0.0] * 5 if found["D_right"] is None else found["D_right"]).reshape(-1),
            T_right_left,
            size,
            T_robot_left,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{where}: {error}") from error
    except (TypeError, ValueError, KeyError, OverflowError, cv2.error) as error:
        raise CalibrationError(f"{where}: a matrix has the wrong shape: {error}") from error


def content_of(rig: StereoRig) -> dict[str, Any]:
    """The rig as `rig_of` and `stereo.json` have it, without its place on the robot."""
    return {
        "width": rig.size[0],
        "height": rig.size[1],
        "K_left": rig.K_left.tolist(),
        "D_left": rig.D_left.tolist(),
        "K_right": rig.K_right.tolist(),
        "D_right": rig.D_right.tolist(),
        "R": rig.T_right_left[:3, :3].tolist(),
        "t": rig.T_right_left[:3, 3].tolist(),
    }


def read_rig(folder: Path, size: tuple[int, int] | None = None) -> StereoRig:
    """Reads the calibration that lies in a folder: one of `RIG_FILES`, or OpenCV's pair
    intrinsics.yml and extrinsics.yml.

    Raises:
        CalibrationError: there is none, or it is impossible.
    """
    for name in (*RIG_FILES, "intrinsics.yml"):
        if (folder / name).is_file():
            return read_rig_file(folder / name, size)
    raise CalibrationError(
        f"{folder} has no calibration: put {', '.join(RIG_FILES)} there, or OpenCV's "
        "intrinsics.yml with extrinsics.yml, or give --calibration FILE"
    )


def read_rig_file(path: Path, size: tuple[int, int] | None = None) -> StereoRig:
    """Reads a calibration: our JSON, OpenCV's yml, xml or json, or Kalibr's camchain yaml.

    Args:
        path: the file; of OpenCV's pair the `intrinsics.yml`, with `extrinsics.yml` beside it.
        size: width, height of the images, used where the file does not say it.

    Raises:
        CalibrationError: there is none, or it is impossible.
    """
    if not path.is_file():
        raise CalibrationError(f"there is no calibration {path}")
    content = _read(path)
    beside = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    if beside != path and beside.is_file():
        content |= _read(beside)
    return rig_of(content, str(path), size)


def _read(path: Path) -> dict[str, Any]:
    if path.suffix in (".yml", ".yaml") and kalibr.is_kalibr(path):
        return kalibr.read_camchain(path)
    if path.suffix != ".json":
        return _read_opencv(path)
    try:
        content = read_json(path)
    except DataFolderError as error:
        raise CalibrationError(str(error)) from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path} holds no names with matrices")
    return content


def _read_opencv(path: Path) -> dict[str, Any]:
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        if not storage.isOpened():
            raise CalibrationError(f"{path} cannot be read as an OpenCV file")
        root = storage.root()
        content = {name: _value(root.getNode(name)) for name in root.keys()}  # noqa: SIM118
    except (cv2.error, SystemError) as error:
        raise CalibrationError(f"{path} cannot be read as an OpenCV file") from error
    storage.release()
    return {name: value for name, value in content.items() if value is not None}


def _value(node: cv2.FileNode) -> Any:
    if node.isMap():
        return node.mat()
    if node.isInt() or node.isReal():
        return node.real()
    if node.isSeq():
        return [node.at(i).real() for i in range(node.size())]
    return None


def _first(content: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    return next((content[name] for name in names if name in content), None)


def _array(value: Any) -> Floats:
    """Nested lists, an array, or the map that OpenCV writes for a matrix into JSON."""
    if isinstance(value, Mapping):
        value = np.asarray(value["data"], np.float64).reshape(value["rows"], value["cols"])
    return np.array(value, np.float64)


def _rotation(R: Floats) -> Floats:
    """A rotation given as a matrix or as a rotation vector."""
    if R.size != 3:
        return R.reshape(3, 3)
    return np.asarray(cv2.Rodrigues(R.reshape(3, 1))[0], np.float64)


def _check_pinhole(name: str, K: Floats, size: tuple[int, int]) -> None:
    largest = max(size)
    if not 0 < largest <= 16384:
        raise CalibrationError(f"images of {size[0]}x{size[1]} px: give width and height")
    inside = np.isfinite(K).all() and 0 < K[0, 2] < size[0] and 0 < K[1, 2] < size[1]
    if not inside or K[0, 0] <= 0 or K[1, 1] <= 0 or K[2].tolist() != [0, 0, 1] or K[1, 0] != 0:
        raise CalibrationError(
            f"{name} is no pinhole matrix of a {size[0]}x{size[1]} image: "
            "it needs [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in pixels"
        )
    if not (0.05 * largest < min(K[0, 0], K[1, 1]) and max(K[0, 0], K[1, 1]) < 200 * largest):
        raise CalibrationError(
            f"{name} has focal lengths {K[0, 0]:g} and {K[1, 1]:g}: they must be in pixels"
        )


def _check_rigid(name: str, T: Floats) -> None:
    R = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise CalibrationError(f"the rotation of {name} is not orthonormal")


def _check_baseline(t: Floats) -> None:
    baseline = float(np.linalg.norm(t))
    if baseline < 1e-4:
        raise CalibrationError("the baseline is zero: t must be the way from left to right camera")
    if baseline > MAX_BASELINE_M:
        raise CalibrationError(
            f"the baseline is {baseline:g} m: t must be in metres (divide millimetres by 1000)"
        )
    if abs(t[0]) < 0.9 * baseline:
        raise CalibrationError(
            f"t = {np.round(t, 4).tolist()} does not point sideways: "
            "only cameras side by side are supported"
        )
    if t[0] > 0:
        raise CalibrationError(
            f"t = {np.round(t, 4).tolist()} puts the right camera on the left: swap the cameras, "
            "or give R and t that map left to right (x_right = R x_left + t)"
        )
