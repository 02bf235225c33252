"""ORB-SLAM's settings: of 2, `LEFT.K`, `RIGHT.P` and their like, or rectified images by `Camera.fx`
and `Camera.bf`; of 3, `Camera1.fx`, `Camera2.fx` and `Stereo.T_c1_c2`, or `Stereo.b`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Lens,
    StereoPair,
    between_rectified,
    inverted,
    lens_model,
    number,
    numbers,
    pinhole,
    rigid,
    sideways,
    size_of,
)

_NORMAL = ("k1", "k2", "p1", "p2", "k3")
_FISHEYE = ("k1", "k2", "k3", "k4")


def recognises(content: Mapping[str, Any]) -> bool:
    """Whether names are those of ORB-SLAM."""
    return any(name.startswith(("Camera.fx", "Camera1.fx", "LEFT.K")) for name in content)


def read(content: Mapping[str, Any], where: str) -> StereoPair:
    """Of version 2 or 3.

    Raises:
        CalibrationError: something is missing.
    """
    if "Camera1.fx" in content or "Camera2.fx" in content:
        return _three(content, where)
    if any(name.startswith(("LEFT.", "RIGHT.")) for name in content):
        return _two(content, where)
    return _rectified(content, where)


def _two(content: Mapping[str, Any], where: str) -> StereoPair:
    needed = ["LEFT.K", "LEFT.D", "LEFT.R", "RIGHT.K", "RIGHT.D", "RIGHT.R", "RIGHT.P"]
    missing = [name for name in needed if content.get(name) is None]
    if missing:
        raise CalibrationError(f"{where} (ORB-SLAM2) lacks {', '.join(missing)}")
    K = [numbers(content, f"{side}.K", where, 9).reshape(3, 3) for side in ("LEFT", "RIGHT")]
    D = [numbers(content, f"{side}.D", where, 4, 5, 8) for side in ("LEFT", "RIGHT")]
    R = [numbers(content, f"{side}.R", where, 9).reshape(3, 3) for side in ("LEFT", "RIGHT")]
    P_right = numbers(content, "RIGHT.P", where, 12).reshape(3, 4)
    size = _size(content, where, "LEFT.width", "LEFT.height") or _size(content, where)
    return StereoPair(
        Lens(K[0], D[0]), Lens(K[1], D[1]), between_rectified(R[0], R[1], P_right), size
    )


def _rectified(content: Mapping[str, Any], where: str) -> StereoPair:
    """Of version 2, and of the older 3: images that are rectified already."""
    lens = _lens(content, "Camera", where)
    if "Camera.bf" not in content:
        raise CalibrationError(f"{where} (ORB-SLAM) is of one eye: it lacks Camera.bf")
    if lens.D.any():
        raise CalibrationError(
            f"{where} (ORB-SLAM) has one camera with distortion for two eyes: give LEFT.K ... "
            "RIGHT.P, or undistort and rectify the images and set its distortion to 0"
        )
    bf = float(numbers(content, "Camera.bf", where, 1)[0])
    return StereoPair(lens, lens, sideways(bf / lens.K[0, 0]), _size(content, where))


def _three(content: Mapping[str, Any], where: str) -> StereoPair:
    if "Stereo.b" in content and "Stereo.T_c1_c2" not in content:
        lens = _lens(content, "Camera1", where)
        return StereoPair(
            lens,
            lens,
            sideways(float(numbers(content, "Stereo.b", where, 1)[0])),
            _size(content, where),
        )
    first = "Camera1" if "Camera1.fx" in content else "Camera"
    lenses = [_lens(content, name, where) for name in (first, "Camera2")]
    if "Stereo.T_c1_c2" in content:
        T_left_right = numbers(content, "Stereo.T_c1_c2", where, 16).reshape(4, 4)
    elif "Tlr" in content:  # of the older one
        T = numbers(content, "Tlr", where, 12, 16).reshape(-1, 4)
        T_left_right = rigid(T[:3, :3], T[:3, 3])
    else:
        raise CalibrationError(f"{where} (ORB-SLAM3) lacks Stereo.T_c1_c2")
    return StereoPair(lenses[0], lenses[1], inverted(T_left_right), _size(content, where))


def _lens(content: Mapping[str, Any], camera: str, where: str) -> Lens:
    K = pinhole(
        *(
            float(numbers(content, f"{camera}.{name}", where, 1)[0])
            for name in ("fx", "fy", "cx", "cy")
        )
    )
    kind = str(content.get("Camera.type", "PinHole"))
    model = "normal" if kind == "Rectified" else lens_model(kind, where)
    names = _FISHEYE if model == "fisheye" else _NORMAL
    D = [number(content.get(f"{camera}.{name}", 0.0), name, where) for name in names]
    return Lens(K, np.array(D), model)


def _size(
    content: Mapping[str, Any],
    where: str,
    width: str = "Camera.width",
    height: str = "Camera.height",
) -> tuple[int, int] | None:
    return size_of(content, where, width, height)
