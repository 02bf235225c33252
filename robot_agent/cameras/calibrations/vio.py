"""Calibrations of visual-inertial tools, which place each camera on a body: EuRoC's sensor.yaml,
VINS-Fusion with camodocal's cameras, Basalt.
"""

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
    rigid,
    size_of,
)


def is_sensor(content: Mapping[str, Any]) -> bool:
    """Whether it is the sensor.yaml of an EuRoC camera."""
    return "T_BS" in content and "intrinsics" in content


def read_sensors(left: Mapping[str, Any], right: Mapping[str, Any], where: str) -> StereoPair:
    """Of EuRoC's sensor.yaml of both eyes."""
    T_body = [numbers(eye, "T_BS", where, 16).reshape(4, 4) for eye in (left, right)]
    lenses = [
        Lens(
            pinhole(*numbers(eye, "intrinsics", where, 4)),
            numbers(eye, "distortion_coefficients", where, 4, 5, 8),
            lens_model(eye.get("distortion_model", "radial-tangential"), where),
        )
        for eye in (left, right)
    ]
    return StereoPair(lenses[0], lenses[1], _between(*T_body), _size(left.get("resolution"), where))


def is_vins(content: Mapping[str, Any]) -> bool:
    """Whether it is the configuration of VINS-Fusion, which names the files of its cameras."""
    return "cam0_calib" in content and "cam1_calib" in content


def read_vins(
    content: Mapping[str, Any], left: Mapping[str, Any], right: Mapping[str, Any], where: str
) -> StereoPair:
    """Of VINS-Fusion's configuration and camodocal's cameras."""
    T_body = [numbers(content, f"body_T_cam{k}", where, 16).reshape(4, 4) for k in (0, 1)]
    lenses = [_camodocal(eye, where) for eye in (left, right)]
    size = size_of(left, where)
    return StereoPair(lenses[0], lenses[1], _between(*T_body), size)


def is_camodocal(content: Mapping[str, Any]) -> bool:
    """Whether it is one camera of camodocal."""
    return "model_type" in content and "projection_parameters" in content


def _camodocal(content: Mapping[str, Any], where: str) -> Lens:
    kind, projection = content.get("model_type"), content.get("projection_parameters")
    if not isinstance(projection, Mapping):
        raise CalibrationError(f"{where}: a camera lacks projection_parameters")
    if kind == "KANNALA_BRANDT":
        fx, fy, cx, cy, *D = _named(
            projection, ("mu", "mv", "u0", "v0", "k2", "k3", "k4", "k5"), where
        )
        return Lens(pinhole(fx, fy, cx, cy), np.array(D), "fisheye")
    if kind != "PINHOLE":
        raise CalibrationError(
            f"{where}: camodocal's model {kind} is not supported: calibrate with PINHOLE or "
            "KANNALA_BRANDT"
        )
    distortion = content.get("distortion_parameters") or {}
    D = _named(distortion, ("k1", "k2", "p1", "p2"), where)
    return Lens(pinhole(*_named(projection, ("fx", "fy", "cx", "cy"), where)), np.array(D))


def is_basalt(content: Mapping[str, Any]) -> bool:
    """Whether it is a calibration of Basalt."""
    value = content.get("value0")
    return isinstance(value, Mapping) and "T_imu_cam" in value


def read_basalt(content: Mapping[str, Any], where: str) -> StereoPair:
    """Of Basalt's JSON: camera 0 is the left one.

    Raises:
        CalibrationError: it has not two cameras, or their model is not supported.
    """
    value = content["value0"]
    poses, cameras = value.get("T_imu_cam"), value.get("intrinsics")
    if not (isinstance(poses, list) and isinstance(cameras, list)) or len(cameras) != 2:
        raise CalibrationError(f"{where} (Basalt) needs T_imu_cam and intrinsics of two cameras")
    if not len(poses) == 2 or not all(isinstance(one, Mapping) for one in (*poses, *cameras)):
        raise CalibrationError(f"{where} (Basalt) needs T_imu_cam and intrinsics of two cameras")
    lenses = [_basalt_lens(camera, where) for camera in cameras]
    resolution = value.get("resolution")
    size = _size(resolution[0], where) if isinstance(resolution, list) and resolution else None
    return StereoPair(
        lenses[0], lenses[1], _between(*(_posed(pose, where) for pose in poses)), size
    )


def _basalt_lens(camera: Mapping[str, Any], where: str) -> Lens:
    kind, values = camera.get("camera_type"), camera.get("intrinsics")
    if not isinstance(values, Mapping):
        raise CalibrationError(f"{where} (Basalt): a camera lacks intrinsics")
    K = pinhole(*_named(values, ("fx", "fy", "cx", "cy"), where))
    if kind == "pinhole":
        return Lens(K, np.zeros(5))
    if kind == "kb4":
        return Lens(K, np.array(_named(values, ("k1", "k2", "k3", "k4"), where)), "fisheye")
    if kind == "pinhole-radtan8":
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return Lens(K, np.array(_named(values, names, where)))
    raise CalibrationError(
        f"{where}: Basalt's camera_type '{kind}' is not supported: calibrate with --cam-types kb4 "
        "or pinhole-radtan8"
    )


def _posed(pose: Mapping[str, Any], where: str) -> Floats:
    px, py, pz, *q = _named(pose, ("px", "py", "pz", "qx", "qy", "qz", "qw"), where)
    length = float(np.linalg.norm(q))
    if not 0.9 < length < 1.1:
        raise CalibrationError(f"{where}: a quaternion has the length {length:.3g}, not 1")
    x, y, z, w = np.array(q) / length
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rigid(R, np.array([px, py, pz]))


def _named(content: Mapping[str, Any], names: tuple[str, ...], where: str) -> list[float]:
    return [float(numbers(content, name, where, 1)[0]) for name in names]


def _between(T_body_left: Floats, T_body_right: Floats) -> Floats:
    return inverted(T_body_right) @ T_body_left


def _size(value: Any, where: str) -> tuple[int, int] | None:
    if not isinstance(value, list) or len(value) != 2:
        return None
    return size_of(dict(zip(("width", "height"), value, strict=True)), where, "width", "height")
