"""Calibrations that come with data sets: KITTI's calib.txt, Middlebury's, ETH3D's."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Lens,
    StereoPair,
    inverted,
    numbers,
    pinhole,
    rigid,
    sideways,
    size_of,
)
from fleetpose.robot_agent.cameras.folders.files import read_numbers

_KITTI = (("P0", "P1"), ("P_rect_00", "P_rect_01"), ("P2", "P3"), ("P_rect_02", "P_rect_03"))
_MM = 1e-3


def is_kitti(content: Mapping[str, Any]) -> bool:
    """Whether it has KITTI's projections."""
    named = "P0" in content or any(name.startswith("P_rect") for name in content)
    return named or ("P2" in content and "P3" in content)


def read_kitti(content: Mapping[str, Any], where: str, colour: bool = False) -> StereoPair:
    """The grey cameras, or those of colour.

    Raises:
        CalibrationError: it has no pair.
    """
    order = _KITTI[2:] + _KITTI[:2] if colour else _KITTI
    names = next((pair for pair in order if all(name in content for name in pair)), None)
    if names is None:
        raise CalibrationError(f"{where} (KITTI) lacks P1 beside P0, or P3 beside P2")
    left, right = (numbers(content, name, where, 12).reshape(3, 4) for name in names)
    baseline = left[0, 3] / left[0, 0] - right[0, 3] / right[0, 0]
    size = None
    if (said := content.get(names[0].replace("P_", "S_"))) is not None and "rect" in names[0]:
        width, height = numbers({"S": said}, "S", where, 2)
        size = size_of({"w": width, "h": height}, where, "w", "h")
    return StereoPair(
        Lens(left[:, :3], np.zeros(5)), Lens(right[:, :3], np.zeros(5)), sideways(baseline), size
    )


def is_middlebury(content: Mapping[str, Any]) -> bool:
    """Whether it is Middlebury's calib.txt."""
    return "cam0" in content and "cam1" in content and "baseline" in content


def read_middlebury(content: Mapping[str, Any], where: str) -> StereoPair:
    """Two rectified cameras whose centres may differ; the baseline is in millimetres."""
    lenses = [
        Lens(numbers(content, name, where, 9).reshape(3, 3), np.zeros(5))
        for name in ("cam0", "cam1")
    ]
    size = size_of(content, where, "width", "height")
    baseline = _MM * float(numbers(content, "baseline", where, 1)[0])
    return StereoPair(lenses[0], lenses[1], sideways(baseline), size)


def is_eth3d(path: Path) -> bool:
    """Whether it is a calibration.txt of ETH3D, by its name: it holds bare numbers."""
    return path.name in ("calibration.txt", "calibration1.txt")


def read_eth3d(path: Path) -> StereoPair:
    """fx fy cx cy of each eye, without distortion, and `extrinsics_1_2.txt` (3x4 or 4x4), whichever
    way it maps: the left eye is left.

    Raises:
        CalibrationError: a file is missing or holds something else.
    """
    files = [path, path.with_name("calibration2.txt"), path.with_name("extrinsics_1_2.txt")]
    for file in files[1:]:
        if not file.is_file():
            raise CalibrationError(
                f"{path} (ETH3D) is of one eye: put {files[1].name} and {files[2].name} beside it, "
                "or play its depth as --camera rgbd"
            )
    lenses = []
    for file in files[:2]:
        row = read_numbers(file).reshape(-1)
        if row.size not in (4, 8) or row[4:].any():
            raise CalibrationError(f"{file} (ETH3D) needs fx fy cx cy of an undistorted camera")
        lenses.append(Lens(pinhole(*row[:4]), np.zeros(5)))
    T = read_numbers(files[2]).reshape(-1)
    if T.size not in (12, 16):
        raise CalibrationError(f"{files[2]} (ETH3D) has {T.size} numbers, not 12 or 16")
    T = rigid(T[:12].reshape(3, 4)[:, :3], T[:12].reshape(3, 4)[:, 3])
    return StereoPair(lenses[0], lenses[1], inverted(T) if T[0, 3] > 0 else T)
