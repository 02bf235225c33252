"""Lists of cameras on a body: OKVIS (`T_SC`), maplab's and SVO's ncamera (`T_B_C`)."""

from collections.abc import Mapping
from typing import Any

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Floats,
    Lens,
    StereoPair,
    inverted,
    lens_model,
    numbers,
    pinhole,
)


def recognises(content: Mapping[str, Any]) -> bool:
    """Whether it is a list of cameras of either tool."""
    return bool(_cameras(content))


def read(content: Mapping[str, Any], where: str) -> StereoPair:
    """Of two cameras; the left one is that which the poses put there.

    Raises:
        CalibrationError: there are not two, or a lens is not supported.
    """
    cameras = _cameras(content)
    tool = "OKVIS" if cameras and "T_SC" in cameras[0] else "maplab"
    where = f"{where} ({tool})"
    if len(cameras) != 2:
        raise CalibrationError(f"{where} has {len(cameras)} cameras: a stereo rig needs two")
    read_one = _okvis if tool == "OKVIS" else _maplab
    (first, T_first, size), (second, T_second, _) = (read_one(one, where) for one in cameras)
    T_second_first = inverted(T_second) @ T_first
    if T_second_first[0, 3] > 0:
        return StereoPair(second, first, inverted(T_second_first), size)
    return StereoPair(first, second, T_second_first, size)


def _cameras(content: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    listed = content.get("cameras")
    if not isinstance(listed, list):
        return []
    return [
        one for one in listed if isinstance(one, Mapping) and ("T_SC" in one or "camera" in one)
    ]


def _okvis(camera: Mapping[str, Any], where: str) -> tuple[Lens, Floats, tuple[int, int]]:
    fx, fy = numbers(camera, "focal_length", where, 2)
    cx, cy = numbers(camera, "principal_point", where, 2)
    D = numbers(camera, "distortion_coefficients", where, 4, 5, 8)
    lens = Lens(pinhole(fx, fy, cx, cy), D, lens_model(camera.get("distortion_type"), where))
    width, height = numbers(camera, "image_dimension", where, 2)
    return lens, numbers(camera, "T_SC", where, 16).reshape(4, 4), (int(width), int(height))


def _maplab(camera: Mapping[str, Any], where: str) -> tuple[Lens, Floats, tuple[int, int]]:
    inner = camera["camera"]
    if not isinstance(inner, Mapping) or inner.get("type") != "pinhole":
        raise CalibrationError(f"{where}: a camera is not of type pinhole")
    K = pinhole(*numbers(inner, "intrinsics", where, 4))
    bent = inner.get("distortion")
    if not isinstance(bent, Mapping):
        raise CalibrationError(f"{where}: a camera lacks distortion")
    D = numbers(bent, "parameters", where, 4, 5, 8)
    size = tuple(int(numbers(inner, f"image_{side}", where, 1)[0]) for side in ("width", "height"))
    T_body_camera = numbers(camera, "T_B_C", where, 16).reshape(4, 4)
    return Lens(K, D, lens_model(bent.get("type"), where)), T_body_camera, (size[0], size[1])
