"""Kalibr's camchain yaml: two pinhole cameras and `T_cn_cnm1`, which maps points of the camera
before to this one.
"""

import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError

log = logging.getLogger(__name__)

_CAMERA = re.compile(r"^\s*cam\d+\s*:", re.MULTILINE)
_OPENCV_HEADER = re.compile(r"\A\s*%YAML[^\n]*\n")  # of a kind that YAML itself does not know


def is_kalibr(path: Path) -> bool:
    """Whether a yaml file names cameras as Kalibr does."""
    return _CAMERA.search(_text_of(path)) is not None


def read_camchain(path: Path) -> dict[str, Any]:
    """The content of a camchain as `robot_agent.cameras.stereo.rig.rig_of` takes it.

    The left camera is the one that the poses put there, whatever its number; `T_robot_left`
    (4, 4) may stand beside the cameras.

    Raises:
        CalibrationError: it is no chain of two pinhole cameras without distortion or with
            `radtan`; the sentence says what to do.
    """
    content = _parsed(path)
    cameras = [content[name] for name in sorted(content) if re.fullmatch(r"cam\d+", str(name))]
    if len(cameras) != 2 or not all(isinstance(camera, Mapping) for camera in cameras):
        raise CalibrationError(
            f"{path} has {len(cameras)} cameras: a stereo rig needs cam0 and cam1"
        )
    first, second = cameras
    T_second_first = _numbers(path, second, "T_cn_cnm1", 16).reshape(4, 4)
    if T_second_first[0, 3] > 0:
        log.info("%s: cam1 is the left camera, cam0 the right one", path)
        first, second = second, first
        T_second_first = np.linalg.inv(T_second_first)
    width, height = _resolution(path, first, second)
    rig = {
        "K_left": _K(path, first),
        "D_left": _D(path, first),
        "K_right": _K(path, second),
        "D_right": _D(path, second),
        "R": T_second_first[:3, :3],
        "t": T_second_first[:3, 3],
        "width": width,
        "height": height,
    }
    if "T_robot_left" in content:
        rig["T_robot_left"] = content["T_robot_left"]
    return rig


def _text_of(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:
        raise CalibrationError(f"{path} cannot be read: {error}") from error


def _parsed(path: Path) -> dict[str, Any]:
    import yaml  # of no other use

    try:
        content = yaml.safe_load(_OPENCV_HEADER.sub("", _text_of(path)))
    except yaml.YAMLError as error:
        raise CalibrationError(f"{path} cannot be read as YAML: {error}") from error
    if not isinstance(content, dict):
        raise CalibrationError(f"{path} holds no cameras")
    return content


def _K(path: Path, camera: Mapping[str, Any]) -> npt.NDArray[np.float64]:
    if camera.get("camera_model") != "pinhole":
        raise CalibrationError(
            f"{path}: camera_model '{camera.get('camera_model')}' is not supported: "
            "calibrate with --models pinhole-radtan"
        )
    fx, fy, cx, cy = _numbers(path, camera, "intrinsics", 4)
    return np.array(((fx, 0, cx), (0, fy, cy), (0, 0, 1.0)))


def _D(path: Path, camera: Mapping[str, Any]) -> npt.NDArray[np.float64]:
    model = camera.get("distortion_model", "none")
    if model == "none":
        return np.zeros(5)
    if model != "radtan":
        raise CalibrationError(
            f"{path}: distortion_model '{model}' is not supported: calibrate with --models "
            "pinhole-radtan, or undistort the images before"
        )
    return _numbers(path, camera, "distortion_coeffs", 4)


def _resolution(path: Path, *cameras: Mapping[str, Any]) -> tuple[int, int]:
    one, other = (_numbers(path, camera, "resolution", 2).astype(int) for camera in cameras)
    if (one != other).any():
        raise CalibrationError(f"{path}: both cameras need the same resolution")
    return int(one[0]), int(one[1])


def _numbers(
    path: Path, camera: Mapping[str, Any], name: str, count: int
) -> npt.NDArray[np.float64]:
    try:
        numbers = np.array(camera[name], np.float64).reshape(-1)
    except KeyError as error:
        raise CalibrationError(f"{path}: a camera lacks {name}") from error
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{path}: {name} holds no numbers") from error
    if numbers.size != count or not np.isfinite(numbers).all():
        raise CalibrationError(f"{path}: {name} needs {count} numbers, it has {numbers.size}")
    return numbers
