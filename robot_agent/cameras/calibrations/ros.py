"""ROS: `camera_info` of both eyes, as `camera_calibration` writes it into left.yaml and
right.yaml, or as messages of both. What rectifies them says how they stand to each other.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Lens,
    StereoPair,
    between_rectified,
    lens_model,
    numbers,
    size_of,
)

_OF_MESSAGES = {
    "k": "camera_matrix",
    "d": "distortion_coefficients",
    "r": "rectification_matrix",
    "p": "projection_matrix",
    "width": "image_width",
    "height": "image_height",
}
"""The fields of a `CameraInfo` (ROS 1: in capitals), as `topic echo` writes them."""


def recognises(content: Mapping[str, Any]) -> bool:
    """Whether it is the file of one eye, or its message."""
    named = _named(content)
    return "projection_matrix" in named and "camera_matrix" in named and "image_width" in named


def read(left: Mapping[str, Any], right: Mapping[str, Any], where: str) -> StereoPair:
    """Of the files of both eyes.

    Raises:
        CalibrationError: something is missing, or it is two times the same eye.
    """
    left, right = _named(left), _named(right)
    P = [numbers(eye, "projection_matrix", where, 12).reshape(3, 4) for eye in (left, right)]
    if P[1][0, 3] == 0:
        raise CalibrationError(
            f"{where}: the right eye's projection_matrix has no baseline (P[0][3] is 0): give the "
            "files of a stereo calibration, the left one's first"
        )
    rotations = [
        numbers(eye, "rectification_matrix", where, 9).reshape(3, 3) for eye in (left, right)
    ]
    lenses = [_lens(eye, where) for eye in (left, right)]
    size = size_of(left, where)
    return StereoPair(
        lenses[0], lenses[1], between_rectified(rotations[0], rotations[1], P[1]), size
    )


def _named(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """A message's fields under the names that `camera_calibration` gives them."""
    return {_OF_MESSAGES.get(name.lower(), name): value for name, value in content.items()}


def _lens(eye: Mapping[str, Any], where: str) -> Lens:
    K = numbers(eye, "camera_matrix", where, 9).reshape(3, 3)
    model = lens_model(eye.get("distortion_model") or "plumb_bob", where)
    if eye.get("distortion_coefficients") is None:
        return Lens(K, np.zeros(5), model)
    return Lens(K, numbers(eye, "distortion_coefficients", where, 4, 5, 8, 12, 14), model)
