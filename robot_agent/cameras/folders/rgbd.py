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
    NO_DEPTH,
    model_of,
    noise_of,
    read_colour,
    read_depth,
    read_json,
    read_numbers,
    read_raw_depth,
)
from fleetpose.robot_agent.cameras.replay import replay_order

log = logging.getLogger(__name__)

FURTHEST_M = 6.0  # beyond, a Kinect's depth is noise
NEAREST_M = 0.3  # before, structured light, time of flight and stereo chips give none
_SHARE = 5.0  # percent of the pixels that may be nearer, or further, all the same
_LOOKED_AT = 8  # depth images of a recording
TUM_STEPS_PER_M = 5000.0
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


def open_camera(source: str, replay: str, depth_scale: float | None = None) -> RgbdRecording:
    """Opens a 7-Scenes or TUM RGB-D folder.

    Args:
        source: the folder.
        replay: `once`, `loop`, `pingpong` or `hold`.
        depth_scale: steps of its depth images per metre; None: what the layout says, where that
            makes depths that such a camera can have.

    Raises:
        DataFolderError: the folder holds no frames of either layout.
        CalibrationError: no intrinsics.
    """
    folder = Path(source)
    if (folder / "depth.txt").is_file():
        shots, K, noise, steps_per_m = (
            _tum_shots(folder),
            _tum_K(folder),
            KINECT_NOISE,
            TUM_STEPS_PER_M,
        )
    else:
        shots, steps_per_m = _seven_scenes_shots(folder), 1000.0
        K, noise = _seven_scenes_calibration(folder)
    if not shots:
        raise DataFolderError(
            f"{folder} holds no RGB-D frames: neither frame-*.depth.png with colour, "
            "nor rgb.txt and depth.txt"
        )
    if depth_scale is None:
        _check_depths([shot.depth for shot in shots], steps_per_m)
    return RgbdRecording(shots, K, noise, depth_scale or steps_per_m, replay)


def _check_depths(paths: list[Path], steps_per_m: float) -> None:
    """Layouts do not say their unit: one that cannot be shows in depths that no camera has."""
    path = paths[0]
    looked_at = [read_raw_depth(one) for one in paths[:: -(-len(paths) // _LOOKED_AT)]]
    raw = np.concatenate([one.reshape(-1) for one in looked_at])
    depth = raw[(raw > 0) & (raw < NO_DEPTH)] / steps_per_m
    if not depth.size:
        return
    near, middle, far = np.percentile(depth, (_SHARE, 50, 100 - _SHARE))
    in_fifths = steps_per_m == TUM_STEPS_PER_M and far < FURTHEST_M / (TUM_STEPS_PER_M / 1000)
    if near >= NEAREST_M and middle <= FURTHEST_M and not in_fifths:
        return
    raise DataFolderError(
        f"{path} would show {near:.2g} to {far:.2g} m at {steps_per_m:g} steps per metre, as its "
        "layout has it, and no such camera does: give --depth-scale STEPS, 1000 if its depths are "
        f"in millimetres, {steps_per_m:g} if they are right"
    )


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
    K = read_numbers(path)
    if K.shape != (3, 3):
        raise CalibrationError(f"{path} holds numbers of shape {K.shape}, need 3x3")
    if K[0, 0] < 0 or K[1, 1] < 0:
        raise CalibrationError(
            f"{path}: fx is {K[0, 0]:g}, fy {K[1, 1]:g}: a focal length below 0 (ICL-NUIM's way of "
            "turning an axis round) is none: write it without the minus"
        )
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
    if not shots and colours and depths:
        apart_s = min(abs(c[0] - d[0]) for c in colours[:50] for d in depths[:50])
        raise DataFolderError(
            f"{folder}: no image of rgb.txt was taken within {1e3 * TUM_MAX_DIFFERENCE_S:g} ms of "
            f"one of depth.txt; the nearest are {1e3 * apart_s:.0f} ms apart: bring both lists to "
            "one clock"
        )
    return shots


def _tum_list(path: Path) -> list[tuple[float, Path]]:
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error
    rows = []
    for number, line in enumerate(lines, 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            rows.append((_seconds(words[0]), path.parent / words[1]))
        except (ValueError, IndexError) as error:
            raise DataFolderError(
                f"{path}, line {number}: '{line.strip()[:60]}' is no time with a file"
            ) from error
    return sorted(rows)


def _seconds(stamp: str) -> float:
    """A time as s; without a decimal point and longer than any since 1970, it is ns, us or ms."""
    value = float(stamp)
    digits = len(stamp.lstrip("+-"))
    if not stamp.isdigit() or digits <= 10:
        return value
    return value * 10.0 ** -(digits - 10)
