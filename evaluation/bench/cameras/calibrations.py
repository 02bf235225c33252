"""Row: one rig in the files of many tools is read as the same rig, or refused by tool."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.cameras.bars import Attempt, Bar
from fleetpose.evaluation.bench.cameras.made import plain, slam
from fleetpose.evaluation.bench.cameras.made.known import (
    FISHEYE,
    SIDES,
    SIZE,
    T_RIGHT_LEFT,
    D,
    Floats,
    K,
    pose,
)
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig_file
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig

TOLERANCE = 1e-9
_SHARE_READ = 0.9  # 18 of 20


@dataclass(frozen=True)
class Expected:
    """What a file says: K, D and T_right_left of the rig, its lens and the size of its images.

    Attributes:
        tool: whose name a refusal must hold.
        write: writes the file into a folder.
        rig: the rig; None where it must be refused.
    """

    tool: str
    write: Callable[[Path], Path]
    rig: StereoRig | None


def _rig(D_of: dict[str, Floats], length: int = 5, fisheye: bool = False) -> StereoRig:
    lenses = [np.append(D_of[side][:length], np.zeros(5 - length)) for side in SIDES]
    if fisheye:
        lenses = [D_of[side] for side in SIDES]
    lens = "fisheye" if fisheye else "normal"
    return StereoRig(K["left"], lenses[0], K["right"], lenses[1], T_RIGHT_LEFT, SIZE, lens=lens)


def _rectified_rig(shift_px: float = 0.0) -> StereoRig:
    left = K["left"].copy()
    left[1, 1] = left[0, 0]
    right = left.copy()
    right[0, 2] += shift_px
    none = np.zeros(5)
    return StereoRig(left, none, right, none, pose((0, 0, 0), (-0.11, 0, 0)), SIZE)


def _zed_rig() -> StereoRig:
    camera = np.array([[700.0, 0, 640.5], [0, 701.0, 361.5], [0, 0, 1]])
    T = pose((0.014, -0.0004, 0.0023), (-0.11, -0.0003, 0.0002))
    return StereoRig(camera, D["left"], camera, D["right"], T, (1280, 720))


def _plain_rig() -> StereoRig:
    none = np.zeros(5)
    return StereoRig(K["left"], none, K["right"], none, T_RIGHT_LEFT, SIZE)


FIVE, FOUR, WIDE = _rig(D), _rig(D, 4), _rig(FISHEYE, fisheye=True)
FILES: tuple[Expected, ...] = (
    Expected("OpenCV", plain.opencv_yml, FIVE),
    Expected("OpenCV", plain.opencv_sample, FIVE),
    Expected("OpenCV", plain.opencv_xml, FIVE),
    Expected("OpenCV", plain.named_with_letters, FIVE),
    Expected("OpenCV", plain.named_by_words, FIVE),
    Expected("OpenCV", plain.named_in_sections, FIVE),
    Expected("OpenCV", plain.numbered_from_zero, FIVE),
    Expected("OpenCV", plain.opencv_fisheye, WIDE),
    Expected("ROS", plain.ros, FIVE),
    Expected("ROS", plain.ros_echo, FIVE),
    Expected("ORB-SLAM2", slam.orbslam2, FIVE),
    Expected("ORB-SLAM2", slam.orbslam2_rectified, _rectified_rig()),
    Expected("ORB-SLAM3", slam.orbslam3, FIVE),
    Expected("ORB-SLAM3", slam.orbslam3_fisheye, WIDE),
    Expected("EuRoC", slam.euroc, FOUR),
    Expected("Kimera", slam.kimera, FOUR),
    Expected("Kalibr", slam.kalibr, FOUR),
    Expected("Kalibr", slam.kalibr_equi, WIDE),
    Expected("Kalibr", slam.kalibr_in_ros, FOUR),
    Expected("Kalibr", slam.kalibr_imu, FOUR),
    Expected("OpenVINS", slam.openvins, FOUR),
    Expected("OKVIS", slam.okvis, FOUR),
    Expected("maplab", slam.maplab, FOUR),
    Expected("VINS-Fusion", slam.vins, FOUR),
    Expected("VINS-Fusion", slam.vins_fisheye, WIDE),
    Expected("Basalt", slam.basalt, FIVE),
    Expected("Basalt", slam.basalt_kb4, WIDE),
    Expected("Basalt", slam.basalt_double_sphere, None),
    Expected("KITTI", plain.kitti, _rectified_rig()),
    Expected("KITTI", plain.kitti_raw, _rectified_rig()),
    Expected("Middlebury", plain.middlebury, _rectified_rig(12.5)),
    Expected("ZED", plain.zed, _zed_rig()),
    Expected("OAK", plain.oak, FIVE),
    Expected("RealSense", plain.realsense, None),
    Expected("ETH3D", plain.eth3d, _plain_rig()),
    Expected("fleetpose", plain.ours, FIVE),
)


def bar(scratch: Path) -> Bar:
    """Writes and reads every file."""
    attempts = list(_tried(scratch))
    least = int(np.ceil(_SHARE_READ * len(attempts)))
    return Bar("c calibrations of other tools", attempts, least, "read to 1e-9")


def _tried(scratch: Path) -> Iterator[Attempt]:
    for expected in FILES:
        name = expected.write.__name__
        path = expected.write(scratch / name)
        says, is_read = outcome_of(expected, path)
        yield Attempt(f"{expected.tool}: {name}", is_read, says)


def outcome_of(expected: Expected, path: Path) -> tuple[str, bool]:
    """What is made of a file, and whether it is right: the same rig, or for one that says not all
    a refusal with the tool's name.
    """
    size = SIZE if expected.rig is None else expected.rig.size
    try:
        rig = read_rig_file(path, size)
    except FleetPoseError as error:
        return f"refused: {error}", expected.rig is None and expected.tool in str(error)
    if expected.rig is None:
        return "read, though it does not say all", False
    off = difference(rig, expected.rig)
    return f"off by {off:.1g}", off <= TOLERANCE


def difference(rig: StereoRig, other: StereoRig) -> float:
    """The largest difference of any number, px, m or without unit; inf between two kinds."""
    if (rig.lens, rig.size) != (other.lens, other.size):
        return float("inf")
    pairs = [(rig.T_right_left, other.T_right_left)]
    for side in SIDES:
        pairs.append((getattr(rig, f"K_{side}"), getattr(other, f"K_{side}")))
        a, b = (np.ravel(getattr(one, f"D_{side}")) for one in (rig, other))
        longer = max(len(a), len(b))
        pairs.append((np.pad(a, (0, longer - len(a))), np.pad(b, (0, longer - len(b)))))
    return max(float(np.abs(a - b).max()) for a, b in pairs)
