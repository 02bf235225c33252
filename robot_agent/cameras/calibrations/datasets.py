"""Calibrations that come with data sets of rectified images: KITTI's calib.txt, Middlebury's."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import Lens, StereoPair, numbers, sideways

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
        size = int(width), int(height)
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
    size = None
    if "width" in content and "height" in content:
        size = int(content["width"]), int(content["height"])
    baseline = _MM * float(numbers(content, "baseline", where, 1)[0])
    return StereoPair(lenses[0], lenses[1], sideways(baseline), size)
