"""What makers write for their devices: Stereolabs' SN*.conf, Luxonis' JSON, Intel's."""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import (
    Floats,
    Lens,
    StereoPair,
    inverted,
    number,
    numbers,
    pinhole,
    rigid,
    size_of,
)

_ZED_SIZES = {
    "2K": (2208, 1242),
    "FHD": (1920, 1080),
    "FHD1200": (1920, 1200),
    "HD": (1280, 720),
    "SVGA": (960, 600),
    "VGA": (672, 376),
}
_ZED_NAMES = ("k1", "k2", "p1", "p2", "k3")
_MM, _CM = 1e-3, 1e-2  # the units of Stereolabs and of Luxonis


def is_zed(content: Mapping[str, Any]) -> bool:
    """Whether it is the file of a Stereolabs ZED."""
    return any(name.startswith("LEFT_CAM_") for name in content)


def read_zed(content: Mapping[str, Any], size: tuple[int, int] | None, where: str) -> StereoPair:
    """The cameras at the size of the images: a file has them at all sizes of the device.

    Raises:
        CalibrationError: it has none of that size.
    """
    known = [name.removeprefix("LEFT_CAM_") for name in content if name.startswith("LEFT_CAM_")]
    fits = [name for name in known if name in _ZED_SIZES and size in (None, _ZED_SIZES[name])]
    if len(fits) != 1:
        sizes = ", ".join(
            f"{_ZED_SIZES[k][0]}x{_ZED_SIZES[k][1]}" for k in known if k in _ZED_SIZES
        )
        raise CalibrationError(
            f"{where} (ZED) has cameras of {sizes or 'no known size'}: give images of one of them"
        )
    mode = fits[0]
    lenses = [_zed_lens(content, f"{side}_CAM_{mode}", where) for side in ("LEFT", "RIGHT")]
    stereo = content.get("STEREO")
    if not isinstance(stereo, Mapping):
        raise CalibrationError(f"{where} (ZED) lacks [STEREO]")
    turn = [_zed_number(stereo, f"{name}_{mode}", where) for name in ("rx", "cv", "rz")]
    shift = [_zed_shift(stereo, name, mode, where) for name in ("ty", "tz")]
    baseline = float(numbers(stereo, "baseline", where, 1)[0])
    # turns points of the left camera to the right one; where that stands is told with another sign
    R = np.asarray(cv2.Rodrigues(np.array(turn))[0], np.float64)
    T = rigid(R, -_MM * np.array([baseline, *shift]))
    return StereoPair(lenses[0], lenses[1], T, _ZED_SIZES[mode])


def _zed_lens(content: Mapping[str, Any], section: str, where: str) -> Lens:
    eye = content.get(section)
    if not isinstance(eye, Mapping):
        raise CalibrationError(f"{where} (ZED) lacks [{section}]")
    K = pinhole(*(float(numbers(eye, name, where, 1)[0]) for name in ("fx", "fy", "cx", "cy")))
    return Lens(K, np.array([_zed_number(eye, name, where) for name in _ZED_NAMES]))


def _zed_number(section: Mapping[str, Any], name: str, where: str) -> float:
    return number(section.get(name.lower(), 0.0), name, where)


def _zed_shift(stereo: Mapping[str, Any], name: str, mode: str, where: str) -> float:
    """Older files have one for all sizes."""
    own = f"{name}_{mode}"
    return _zed_number(stereo, own if own.lower() in stereo else name, where)


def is_oak(content: Mapping[str, Any]) -> bool:
    """Whether it is what Luxonis' devices hold."""
    return "cameraData" in content


def read_oak(content: Mapping[str, Any], where: str) -> StereoPair:
    """The cameras that the device itself takes for a stereo pair.

    Raises:
        CalibrationError: one of them is not in the file, or nothing joins them.
    """
    try:
        cameras = {int(socket): camera for socket, camera in content["cameraData"]}
        pair = content["stereoRectificationData"]
        left, right = int(pair["leftCameraSocket"]), int(pair["rightCameraSocket"])
    except (KeyError, TypeError, ValueError) as error:
        raise CalibrationError(f"{where} (OAK) lacks its cameras or which are the pair") from error
    for side, socket in (("left", left), ("right", right)):
        if not isinstance(cameras.get(socket), Mapping):
            raise CalibrationError(f"{where} (OAK) lacks the {side} camera, of socket {socket}")
    lenses = [_oak_lens(cameras[socket], where) for socket in (left, right)]
    size = size_of(cameras[left], where, "width", "height")
    return StereoPair(lenses[0], lenses[1], _oak_between(cameras, left, right, where), size)


def _oak_lens(camera: Mapping[str, Any], where: str) -> Lens:
    K = numbers(camera, "intrinsicMatrix", where, 9).reshape(3, 3)
    D = numbers(camera, "distortionCoeff", where, 4, 5, 8, 12, 14)
    if camera.get("cameraType", 0) == 1:
        return Lens(K, D[:4], "fisheye")
    return Lens(K, D)


def _oak_between(cameras: Mapping[int, Any], left: int, right: int, where: str) -> Floats:
    """T_right_left, metres: each camera says how its points map to the next one."""
    T_next: dict[int, tuple[int, Floats]] = {}
    for socket, camera in cameras.items():
        joined = camera.get("extrinsics") if isinstance(camera, Mapping) else None
        if not isinstance(joined, Mapping) or joined.get("toCameraSocket", -1) in (-1, None):
            continue
        shift = joined.get("translation")
        if not isinstance(shift, Mapping) or not joined.get("rotationMatrix"):
            continue
        R = numbers(joined, "rotationMatrix", where, 9).reshape(3, 3)
        t = _CM * np.array([float(numbers(shift, axis, where, 1)[0]) for axis in "xyz"])
        T_next[socket] = int(number(joined["toCameraSocket"], "toCameraSocket", where)), rigid(R, t)
    ways = {socket: _oak_way(T_next, socket) for socket in (left, right)}
    shared = next((socket for socket in ways[left] if socket in ways[right]), None)
    if shared is None:
        raise CalibrationError(f"{where} (OAK): nothing says how its two eyes stand to each other")
    return inverted(ways[right][shared]) @ ways[left][shared]


def _oak_way(T_next: Mapping[int, tuple[int, Floats]], socket: int) -> dict[int, Floats]:
    """T_other_socket of a camera and of all that its chain leads to."""
    way, T, at = {socket: np.eye(4)}, np.eye(4), socket
    while at in T_next and T_next[at][0] not in way:
        at, step = T_next[at]
        T = step @ T
        way[at] = T
    return way


def is_realsense(content: Mapping[str, Any]) -> bool:
    """Whether it is a dump of an Intel RealSense."""
    return "streams" in content and ("device" in content or "depth_units" in content)


def refuse_realsense(where: str) -> StereoPair:
    """Its formats differ, and none says the unit of its baseline."""
    raise CalibrationError(
        f"{where} (RealSense) does not say all of both eyes: its infrared images are rectified, so "
        'write stereo.json with "K_left" and "K_right" the same, "R" the identity and "t" '
        "[-baseline in metres, 0, 0], or play its depth as --camera rgbd"
    )
