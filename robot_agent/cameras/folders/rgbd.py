"""Recorded RGB-D cameras: 7-Scenes folders and TUM RGB-D folders, by what lies in them.

7-Scenes: `frame-*.depth.png` (uint16 millimetres, 0 and 65535 = none) with
`frame-*.color_registered.jpg`, else `frame-*.color.jpg` or `.png`, and `camera-intrinsics.txt`
(3x3) or `calib.json`.
TUM: `rgb.txt` and `depth.txt` (lines of time and file), depth in 1/5000 m, `camera-intrinsics.txt`
    or TUM's own default.
"""

import bisect
import logging
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, NoiseModel
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.robot_agent.cameras.folders.files import (
    model_of,
    noise_of,
    read_colour,
    read_depth,
    read_json,
)
from fleetpose.robot_agent.cameras.replay import replay_order

log = logging.getLogger(__name__)

FURTHEST_M = 6.0  # beyond, a Kinect's depth is noise
KINECT_NOISE = NoiseModel(pixel_sigma_px=0.7, depth_sigma_m=(0.0008, 0.0, 0.0016))
"""A Kinect's axial noise 0.0012 + 0.0019 (z - 0.4)^2 (Nguyen, Izadi and Lovell, 3DIMPVT 2012).

As a polynomial without negative coefficients: at most 30 % more between 0.5 and 5 m, 2 % less."""
TUM_K = np.array([[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]])
TUM_MAX_DIFFERENCE_S = 0.02
COLOUR_ENDINGS = (".color_registered.jpg", ".color_registered.png", ".color.jpg", ".color.png")


@dataclass(frozen=True)
class Shot:
    """The two files of one frame."""

    colour: Path
    depth: Path


class RgbdRecording:
    """A recorded RGB-D camera; every frame gets the time at which it is shown."""

    def __init__(
        self,
        shots: list[Shot],
        K: npt.NDArray[np.float64],
        noise: NoiseModel,
        depth_steps_per_m: float,
        replay: str,
    ) -> None:
        self._shots = shots
        self._K = K
        self._noise = noise
        self._depth_steps_per_m = depth_steps_per_m
        self._order = replay_order(len(shots), replay)

    def frames(self) -> Iterator[Frame]:
        for index in self._order:
            yield self._frame(self._shots[index])

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, shot: Shot) -> Frame:
        stamp_ns = time.time_ns()
        image = read_colour(shot.colour)
        depth = read_depth(shot.depth, self._depth_steps_per_m, FURTHEST_M)
        if image.shape[:2] != depth.shape:
            raise CalibrationError(
                f"{shot.colour.name} is {image.shape[1]}x{image.shape[0]}, its depth "
                f"{depth.shape[1]}x{depth.shape[0]}: register the colour images to the depth images"
            )
        return Frame(stamp_ns, image, DepthImage(depth), self._model(*depth.shape))

    def _model(self, height: int, width: int) -> CameraModel:
        return model_of(
            f"the calibration of {self._shots[0].depth.parent}",
            width=width,
            height=height,
            K=self._K,
            T_robot_camera=ROBOT_FROM_CAMERA,
            noise=self._noise,
            kind="rgbd",
        )


def open_camera(source: str, replay: str) -> RgbdRecording:
    """Opens a 7-Scenes or TUM RGB-D folder.

    Raises:
        DataFolderError: the folder holds no frames of either layout.
        CalibrationError: no intrinsics.
    """
    folder = Path(source)
    if (folder / "depth.txt").is_file():
        shots, K, noise, steps_per_m = _tum_shots(folder), _tum_K(folder), KINECT_NOISE, 5000.0
    else:
        shots, steps_per_m = _seven_scenes_shots(folder), 1000.0
        K, noise = _seven_scenes_calibration(folder)
    if not shots:
        raise DataFolderError(
            f"{folder} holds no RGB-D frames: neither frame-*.depth.png with colour, "
            "nor rgb.txt and depth.txt"
        )
    return RgbdRecording(shots, K, noise, steps_per_m, replay)


def _seven_scenes_shots(folder: Path) -> list[Shot]:
    shots = []
    for depth in sorted(folder.glob("frame-*.depth.png")):
        stem = depth.name.removesuffix(".depth.png")
        candidates = [folder / (stem + ending) for ending in COLOUR_ENDINGS]
        colour = next((path for path in candidates if path.is_file()), None)
        if colour is None:
            raise DataFolderError(
                f"{depth} has no colour image: put {candidates[0].name} beside it"
            )
        shots.append(Shot(colour, depth))
    if shots and ".color_registered" not in shots[0].colour.name:
        log.warning("%s: no registered colour, taking .color images as registered to depth", folder)
    return shots


def _seven_scenes_calibration(folder: Path) -> tuple[npt.NDArray[np.float64], NoiseModel]:
    path = folder / "calib.json"
    calib = read_json(path) if path.is_file() else {}
    noise = noise_of(calib["noise"], path) if "noise" in calib else KINECT_NOISE
    K = _intrinsics_file(folder)
    if K is None and "depth_intrinsics" in calib:
        pinhole = calib["depth_intrinsics"]
        try:
            fx, fy, cx, cy = (float(pinhole[name]) for name in ("fx", "fy", "cx", "cy"))
        except (KeyError, TypeError, ValueError) as error:
            raise CalibrationError(
                f"{path}: depth_intrinsics needs the numbers fx, fy, cx and cy"
            ) from error
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    if K is None:
        raise CalibrationError(
            f"{folder} has no calibration: put the 3x3 matrix of the depth camera into "
            "camera-intrinsics.txt there, or fx, fy, cx, cy under depth_intrinsics into calib.json"
        )
    return K, noise


def _tum_K(folder: Path) -> npt.NDArray[np.float64]:
    K = _intrinsics_file(folder)
    if K is None:
        log.warning(
            "%s: no camera-intrinsics.txt, taking TUM's default f 525, c 319.5 239.5", folder
        )
        return TUM_K
    return K


def _intrinsics_file(folder: Path) -> npt.NDArray[np.float64] | None:
    path = folder / "camera-intrinsics.txt"
    if not path.is_file():
        return None
    try:
        K = np.loadtxt(path)
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path} is no 3x3 matrix of numbers: {error}") from error
    if K.shape != (3, 3):
        raise CalibrationError(f"{path} holds numbers of shape {K.shape}, need 3x3")
    return K


def _tum_shots(folder: Path) -> list[Shot]:
    """Each depth image with the colour image nearest in time, if that is near enough."""
    colours, depths = _tum_list(folder / "rgb.txt"), _tum_list(folder / "depth.txt")
    times = [stamp_s for stamp_s, _ in colours]
    shots = []
    for stamp_s, depth in depths:
        k = bisect.bisect_left(times, stamp_s)
        near = min(colours[max(k - 1, 0) : k + 1], key=lambda c: abs(c[0] - stamp_s), default=None)
        if near is not None and abs(near[0] - stamp_s) <= TUM_MAX_DIFFERENCE_S:
            shots.append(Shot(near[1], depth))
    return shots


def _tum_list(path: Path) -> list[tuple[float, Path]]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
        return sorted((float(stamp_s), path.parent / name) for stamp_s, name in rows)
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} is no list of times and files: {error}") from error
