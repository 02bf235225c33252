"""What infos say of the camera, or a calibration that is given in their place."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.lens import between_rectified, lens_model, sideways
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig_file
from fleetpose.robot_agent.cameras.rgbd.intrinsics import read_intrinsics
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.topics.mounting import axes_rectified
from fleetpose.rosmsg.camera_infos import CameraInfo

Floats = npt.NDArray[np.float64]


def rig_of(left: CameraInfo, right: CameraInfo, rectified: bool, T_robot_left: Floats) -> StereoRig:
    """The rig that two infos describe.

    Args:
        left, right: of both eyes.
        rectified: whether the images are, as those of `image_rect`.
        T_robot_left: (4, 4) of the left camera's own axes, as tf tells it.

    Raises:
        CalibrationError: such a rig cannot be.
    """
    if left.size != right.size:
        raise CalibrationError(
            f"the infos of both eyes are of {left.size} and {right.size} px: they must be equal"
        )
    if rectified:
        none = np.zeros(5)
        T_right_left = sideways(-right.sideways_m)
        T_robot_rectified = axes_rectified(T_robot_left, left.R)
        return StereoRig(
            *(left.K_rectified, none, right.K_rectified, none, T_right_left),
            *(left.size, T_robot_rectified),
        )
    lens = lens_model(left.model or "plumb_bob", f"the camera_info of '{left.frame_id}'")
    T_right_left = between_rectified(left.R, right.R, right.P)
    return StereoRig(left.K, left.D, right.K, right.D, T_right_left, left.size, T_robot_left, lens)


def rig_given(
    calibration: Path, size: tuple[int, int], unit: float | None, T_robot_left: Floats | None
) -> StereoRig:
    """The rig of a file; it sits where tf says, if tf does.

    Raises:
        CalibrationError: the file cannot be used.
    """
    rig = read_rig_file(calibration, size, unit)
    if T_robot_left is None:
        return rig
    return StereoRig(
        *(rig.K_left, rig.D_left, rig.K_right, rig.D_right, rig.T_right_left, rig.size),
        *(T_robot_left, rig.lens),
    )


def info_given(calibration: Path, size: tuple[int, int], frame_id: str) -> CameraInfo:
    """A camera without distortion out of a file of intrinsics.

    Raises:
        CalibrationError: the file cannot be used.
    """
    K = np.asarray(read_intrinsics(calibration).K, np.float64)
    P = np.hstack((K, np.zeros((3, 1))))
    return CameraInfo(K, np.zeros(5), np.eye(3), P, size, "plumb_bob", frame_id)
