"""The pinhole of an RGB-D recording, from whatever file says it, and the unit of its depths where
that file says it too.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import NoiseModel
from fleetpose.robot_agent.cameras.calibrations.lens import Floats, flat, number, pinhole
from fleetpose.robot_agent.cameras.calibrations.tree import read_tree
from fleetpose.robot_agent.cameras.folders.files import noise_of, read_numbers

NOISE_FILE = "calib.json"
"""May say the camera's noise beside another file that has its intrinsics."""
FILES = (
    "camera-intrinsics.txt",
    NOISE_FILE,
    "calibration.txt",  # ETH3D
    "intrinsics.txt",
    "intrinsic/intrinsic_depth.txt",  # ScanNet
    "cam_params.json",  # Replica
    "../cam_params.json",
    *("camera.json", "intrinsic.json", "intrinsics.json", "camera_intrinsic.json"),
    *("camera.yaml", "camera.yml", "camera_info.yaml"),
)
_MATRICES = ("intrinsic_matrix", "camera_matrix", "k")
_SCALES = ("scale", "png_depth_scale", "depth_scale", "depthmapfactor", "depth_map_factor")


@dataclass(frozen=True)
class Intrinsics:
    """K (3, 3) px; depth steps per metre and noise where the file says them."""

    K: Floats
    steps_per_m: float | None = None
    noise: NoiseModel | None = None


def intrinsics_in(folder: Path) -> Intrinsics | None:
    """Of the first file of a folder that is one of `FILES`.

    Raises:
        CalibrationError: it cannot be used.
    """
    path = next((folder / name for name in FILES if (folder / name).is_file()), None)
    if path is None:
        return None
    found, beside = read_intrinsics(path), folder / NOISE_FILE
    if found.noise is None and beside.is_file():
        content = read_tree(beside)
        if "noise" in content:
            return replace(found, noise=noise_of(content["noise"], beside))
    return found


def read_intrinsics(path: Path) -> Intrinsics:
    """Of a file of numbers (fx fy cx cy, 3x3 or 4x4), or of JSON or YAML with fx, fy, cx and cy or
    a matrix anywhere in it.

    Raises:
        CalibrationError: it is neither, or no camera has such numbers.
    """
    if not path.is_file():
        raise CalibrationError(f"there is no calibration {path}")
    found = _of_numbers(path) if path.suffix == ".txt" else _of_names(path)
    K = found.K
    if K[0, 0] < 0 or K[1, 1] < 0:
        raise CalibrationError(
            f"{path}: fx is {K[0, 0]:g}, fy {K[1, 1]:g}: a focal length below 0 (ICL-NUIM's way of "
            "turning an axis round) is none: write it without the minus"
        )
    return found


def _of_numbers(path: Path) -> Intrinsics:
    rows = read_numbers(path)
    if rows.shape in ((3, 3), (4, 4)):
        return Intrinsics(rows[:3, :3])
    if rows.size in (4, 8) and len(rows) == 1:  # ETH3D's has 8 where there is distortion
        if rows[0, 4:].any():
            raise CalibrationError(f"{path} has distortion: undistort colour and depth before")
        return Intrinsics(pinhole(*rows[0, :4]))
    raise CalibrationError(
        f"{path} holds numbers of shape {rows.shape}, need 3x3, or fx fy cx cy in one line"
    )


def _of_names(path: Path) -> Intrinsics:
    content, where = read_tree(path), str(path)
    noise = noise_of(content["noise"], path) if "noise" in content else None
    values = dict(_names(content))
    scale = next((values[name] for name in _SCALES if name in values), None)
    steps_per_m = None if scale is None else number(scale, "the scale of depth", where)
    four = [values.get(name) for name in ("fx", "fy", "cx", "cy")]
    if all(value is not None for value in four):
        K = pinhole(*(number(value, "fx, fy, cx, cy", where) for value in four))
        return Intrinsics(K, steps_per_m, noise)
    matrix = next((values[name] for name in _MATRICES if name in values), None)
    if matrix is None:
        raise CalibrationError(
            f"{path} has no fx, fy, cx and cy, and no matrix under {', '.join(_MATRICES)}"
        )
    return Intrinsics(_matrix(flat(matrix, "the matrix", where), where), steps_per_m, noise)


def _matrix(values: npt.NDArray[np.float64], where: str) -> Floats:
    """Row by row, or column by column as Open3D writes it."""
    if values.size != 9:
        raise CalibrationError(f"{where}: the matrix has {values.size} numbers, not 9")
    K = values.reshape(3, 3)
    return K if K[2].tolist() == [0, 0, 1] else K.T


def _names(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """All names, in lower case and without what they lie in; later ones count: what lies deeper,
    and of several cameras that of depth.
    """
    for name, value in content.items():
        yield str(name).rpartition(".")[2].lower(), value
    for _, value in sorted(content.items(), key=lambda item: "depth" in str(item[0]).lower()):
        if isinstance(value, Mapping):
            yield from _names(value)
