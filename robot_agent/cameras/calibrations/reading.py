"""Reads a rig from the calibration that somebody has, whichever tool wrote it."""

import logging
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.robot_agent.cameras.calibrations import (
    datasets,
    devices,
    kalibr,
    listed,
    named,
    orbslam,
    ros,
    vio,
)
from fleetpose.robot_agent.cameras.calibrations.lens import StereoPair, check_centre
from fleetpose.robot_agent.cameras.calibrations.tree import read_tree
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig

log = logging.getLogger(__name__)

Size = tuple[int, int]

RIG_FILES = ("stereo.json", "stereo.yml", "stereo.yaml", "stereo.xml", "camchain.yaml")
OTHER_FILES = (
    *("intrinsics.yml", "left.yaml", "left.yml", "calib.txt", "calib_cam_to_cam.txt"),
    *("mav0/cam0/sensor.yaml", "cam0/sensor.yaml", "sensor.yaml"),
)
USUAL_BASELINE_M = 0.8
"""Wider rigs are believed only where the unit of their translation was told: KITTI's car, the
widest that is used much, has 0.54 m; calibrations in a chessboard's squares begin at 0.9."""
_SIDES = (
    ("left", "right"),
    ("cam0", "cam1"),
    ("camera0", "camera1"),
    ("Left", "Right"),
    ("LEFT", "RIGHT"),
    ("infra1", "infra2"),
    ("_l.", "_r."),
    ("_0.", "_1."),
)
TOOLS = (
    "OpenCV (also with intrinsics.yml and extrinsics.yml), Kalibr, OpenVINS, ROS camera_info "
    "(left.yaml with right.yaml), ORB-SLAM2 and 3, EuRoC sensor.yaml, Kimera-VIO, OKVIS, maplab, "
    "VINS-Fusion, Basalt, KITTI, Middlebury, ETH3D, Stereolabs ZED, Luxonis OAK"
)


def read_rig(folder: Path, size: Size | None = None, unit_m: float | None = None) -> StereoRig:
    """Reads the calibration that lies in a folder, under one of the usual names, or the only
    Stereolabs SN*.conf.

    Raises:
        CalibrationError: there is none, or it is impossible.
    """
    usual = [folder / name for name in (*RIG_FILES, *OTHER_FILES)]
    for path in (*usual, *sorted(folder.glob("SN*.conf"))):
        if path.is_file():
            return read_rig_file(path, size, unit_m)
    raise CalibrationError(
        f"{folder} has no calibration: put {', '.join(RIG_FILES)} there, or give --calibration "
        f"FILE of {TOOLS}"
    )


def read_rig_file(path: Path, size: Size | None = None, unit_m: float | None = None) -> StereoRig:
    """Reads a calibration, of any tool in `TOOLS`.

    Args:
        path: the file; where each eye has its own, that of the left one, with the right one's
            beside it.
        size: width, height of the images, px, used where the file does not say it.
        unit_m: of the file's translations, metres; None: metres, where that can be.

    Raises:
        CalibrationError: there is none, or it is impossible; the sentence says what to do.
    """
    if not path.is_file():
        raise CalibrationError(f"there is no calibration {path}")
    if datasets.is_eth3d(path):
        pair = datasets.read_eth3d(path)
    else:
        pair = _read(path, read_tree(path), size)
    return rig_of_pair(pair, str(path), size, unit_m)


def rig_of(content: Mapping[str, Any], where: str, size: Size | None = None) -> StereoRig:
    """A rig from named matrices.

    Args:
        content: K_left, D_left, K_right, D_right, R, t, or other names for them; optionally width
            and height, T_robot_left (4, 4), and `distortion_model`. Distortion may be left out
            where there is none.
        where: what to call the source in errors.
        size: of the images, used where the content does not say it.

    Raises:
        CalibrationError: something is missing or impossible.
    """
    return rig_of_pair(named.read(content, where), where, size)


def rig_of_pair(
    pair: StereoPair, where: str, size: Size | None = None, unit_m: float | None = None
) -> StereoRig:
    """The rig that a file's content makes, in metres.

    Raises:
        CalibrationError: it cannot be.
    """
    if pair.size is None and size is not None:
        check_centre(pair.left.K, size, where)
        check_centre(pair.right.K, size, where)
    size = pair.size or size
    if size is None:
        raise CalibrationError(f"{where} lacks width and height of the images")
    if pair.left.model != pair.right.model:
        raise CalibrationError(f"{where}: one eye is a fisheye, the other is not")
    T_right_left = pair.T_right_left.copy()
    T_right_left[:3, 3] *= unit_m or 1.0
    try:
        _check_unit(T_right_left[:3, 3], unit_m)
        return StereoRig(
            pair.left.K,
            pair.left.D,
            pair.right.K,
            pair.right.D,
            T_right_left,
            size,
            ROBOT_FROM_CAMERA.copy() if pair.T_robot_left is None else pair.T_robot_left,
            pair.left.model,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{where}: {error}") from error


def _check_unit(t: np.ndarray, unit_m: float | None) -> None:
    baseline = float(np.linalg.norm(t))
    if unit_m is None and baseline > USUAL_BASELINE_M:
        raise CalibrationError(
            f"t = {np.round(t, 4).tolist()} would put the eyes {baseline:.3g} m apart: is it in "
            "metres? say what one of it is, in metres: --translation-unit 0.001 for millimetres, "
            "0.01 for centimetres, the side of a square (e.g. 0.025) for a chessboard's squares, 1 "
            "if it is metres"
        )


def _read(path: Path, content: Mapping[str, Any], size: Size | None) -> StereoPair:
    where = str(path)
    alone: tuple[tuple[Callable[[Mapping[str, Any]], bool], Callable[[], StereoPair]], ...] = (
        (devices.is_zed, lambda: devices.read_zed(content, size, where)),
        (devices.is_oak, lambda: devices.read_oak(content, where)),
        (devices.is_realsense, lambda: devices.refuse_realsense(where)),
        (datasets.is_middlebury, lambda: datasets.read_middlebury(content, where)),
        (datasets.is_kitti, lambda: datasets.read_kitti(content, where, _is_colour(path))),
        (vio.is_basalt, lambda: vio.read_basalt(content, where)),
        (listed.recognises, lambda: listed.read(content, where)),
        (vio.is_vins, lambda: _vins(path, content)),
        (kalibr.recognises, lambda: kalibr.read(content, where)),
        (orbslam.recognises, lambda: orbslam.read(content, where)),
        (ros.recognises, lambda: ros.read(content, _right_of(path, "ROS camera_info"), where)),
        (vio.is_sensor, lambda: vio.read_sensors(content, _right_of(path, "EuRoC"), where)),
    )
    for recognises, read in alone:
        if recognises(content):
            return read()
    if vio.is_camodocal(content):
        raise CalibrationError(
            f"{where} (camodocal) is of one eye and does not say where that stands: give VINS-"
            "Fusion's configuration, with cam0_calib, cam1_calib, body_T_cam0 and body_T_cam1"
        )
    beside = path.with_name(path.name.replace("intrinsics", "extrinsics"))
    if beside != path and beside.is_file():
        content = {**content, **read_tree(beside)}
    if not named.recognises(content):
        names = ", ".join(list(content)[:6])
        raise CalibrationError(
            f"{where} lacks K_left, K_right, R, t, and is no calibration of a known tool (it has "
            f"{names}): known are {TOOLS}"
        )
    return named.read(content, where)


def _vins(path: Path, content: Mapping[str, Any]) -> StereoPair:
    files = [path.parent / str(content[name]) for name in ("cam0_calib", "cam1_calib")]
    for file in files:
        if file.name not in {one.name for one in path.parent.iterdir()}:
            raise CalibrationError(
                f"{path} (VINS-Fusion) names {file.name[:80]}, which is not beside it"
            )
    return vio.read_vins(content, read_tree(files[0]), read_tree(files[1]), str(path))


def _right_of(path: Path, tool: str) -> Mapping[str, Any]:
    """The content of the right eye's file, by the left one's name."""
    tried = list(_partners(path))
    for partner in tried:
        if partner.is_file():
            log.info("calibration left=%s right=%s", path, partner)
            return read_tree(partner)
    raise CalibrationError(
        f"{path} ({tool}) is of one eye: put the right one's beside it"
        + (f", as {tried[0]}" if tried else ": left.yaml with right.yaml, or cam0/ with cam1/")
    )


def _partners(path: Path) -> Iterator[Path]:
    for left, right in _SIDES:
        if left in path.name:
            yield path.with_name(path.name.replace(left, right))
        if re.search(rf"(^|[^a-z]){re.escape(left)}", path.parent.name):
            yield path.parent.with_name(path.parent.name.replace(left, right)) / path.name


def _is_colour(path: Path) -> bool:
    """Whether only the colour images of a KITTI sequence lie beside its calibration."""
    return (path.parent / "image_2").is_dir() and not (path.parent / "image_0").is_dir()
