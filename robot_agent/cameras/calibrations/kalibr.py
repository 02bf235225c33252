"""Kalibr's camchain: `cam0` and `cam1`, joined by `T_cn_cnm1`, which maps points of the camera
before to this one, or by where both stand on an IMU (`T_cam_imu`; OpenVINS: `T_imu_cam`).
"""

import logging
import re
from collections.abc import Mapping
from typing import Any

import numpy as np

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

log = logging.getLogger(__name__)


def recognises(content: Mapping[str, Any]) -> bool:
    """Whether cameras are named as Kalibr does, be it among a ROS node's parameters."""
    return any(re.fullmatch(r"cam\d+", name) for name in _unwrapped(content))


def read(content: Mapping[str, Any], where: str) -> StereoPair:
    """The left camera is the one that the poses put there, whatever its number.

    Raises:
        CalibrationError: it is no pair of pinhole cameras; the sentence says what to do.
    """
    content = _unwrapped(content)
    cameras = [content[name] for name in sorted(content) if re.fullmatch(r"cam\d+", name)]
    if len(cameras) != 2 or not all(isinstance(camera, Mapping) for camera in cameras):
        raise CalibrationError(
            f"{where} has {len(cameras)} cameras: a stereo rig needs cam0 and cam1"
        )
    first, second = cameras
    T_second_first = _between(first, second, where)
    if T_second_first[0, 3] > 0:
        log.info("%s: cam1 is the left camera, cam0 the right one", where)
        first, second = second, first
        T_second_first = inverted(T_second_first)
    one, other = (numbers(camera, "resolution", where, 2) for camera in (first, second))
    if (one != other).any():
        raise CalibrationError(f"{where}: both cameras need the same resolution")
    T_robot_left = None
    if "T_robot_left" in content:
        T_robot_left = numbers(content, "T_robot_left", where, 16).reshape(4, 4)
    return StereoPair(
        _lens(first, where),
        _lens(second, where),
        T_second_first,
        (int(one[0]), int(one[1])),
        T_robot_left,
    )


def _unwrapped(content: Mapping[str, Any]) -> Mapping[str, Any]:
    for name in ("/**", "ros__parameters"):
        inner = content.get(name)
        if isinstance(inner, Mapping):
            content = {str(key): value for key, value in inner.items()}
    return content


def _between(first: Mapping[str, Any], second: Mapping[str, Any], where: str) -> Floats:
    if "T_cn_cnm1" in second:
        return numbers(second, "T_cn_cnm1", where, 16).reshape(4, 4)
    for name, is_of_camera in (("T_cam_imu", True), ("T_imu_cam", False)):
        if name in first and name in second:
            a, b = (numbers(one, name, where, 16).reshape(4, 4) for one in (first, second))
            return b @ inverted(a) if is_of_camera else inverted(b) @ a
    raise CalibrationError(f"{where} lacks T_cn_cnm1 of its second camera, or T_cam_imu of both")


def _lens(camera: Mapping[str, Any], where: str) -> Lens:
    if camera.get("camera_model") != "pinhole":
        raise CalibrationError(
            f"{where}: camera_model '{camera.get('camera_model')}' is not supported: "
            "calibrate with --models pinhole-radtan or pinhole-equi"
        )
    K = pinhole(*numbers(camera, "intrinsics", where, 4))
    named = camera.get("distortion_model", "none")
    if named == "none":
        return Lens(K, np.zeros(5))
    return Lens(K, numbers(camera, "distortion_coeffs", where, 4), lens_model(named, where))
