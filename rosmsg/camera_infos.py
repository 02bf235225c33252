"""`sensor_msgs/CameraInfo`: the lens, and what rectifies its images."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError

Floats = npt.NDArray[np.float64]

_FISHEYE = ("equidistant", "fisheye")
_SAME_PX = 1e-6
_LARGEST_PX = 50_000_000


@dataclass(frozen=True)
class CameraInfo:
    """One camera.

    Attributes:
        K: (3, 3) pinhole of the raw images, px.
        D: their distortion.
        R: (3, 3) turns the camera's own axes to the rectified ones.
        P: (3, 4) projection of the rectified images; P[0, 3] = -fx times the baseline in the right
            one of two.
        size: width, height, px.
        model: of the distortion, as ROS calls it.
        frame_id: the optical frame.
    """

    K: Floats
    D: Floats
    R: Floats
    P: Floats
    size: tuple[int, int]
    model: str
    frame_id: str

    @property
    def is_fisheye(self) -> bool:
        """Whether the distortion's numbers are those of `cv2.fisheye`."""
        return self.model in _FISHEYE

    @property
    def is_undistorted(self) -> bool:
        """Whether its raw images need no rectification."""
        return (
            not self.D.any()
            and bool(np.allclose(self.R, np.eye(3), atol=1e-9))
            and bool(np.allclose(self.P[:, :3], self.K, atol=_SAME_PX))
        )

    @property
    def K_rectified(self) -> Floats:
        """(3, 3) pinhole of the rectified images, px."""
        return self.P[:, :3].copy()

    @property
    def sideways_m(self) -> float:
        """Where the first camera stands in the rectified axes of this one: minus the baseline in
        the right one of two, 0 in a lone one.
        """
        return float(self.P[0, 3] / self.P[0, 0])


def camera_info(message: Any) -> CameraInfo:
    """Of a message. What it leaves out (zeros in R and P) is as without rectification.

    Raises:
        CalibrationError: it is not calibrated.
    """
    K = _numbers(message, "k").reshape(3, 3)
    D, R = _numbers(message, "d").reshape(-1), _numbers(message, "r").reshape(3, 3)
    P = _numbers(message, "p").reshape(3, 4)
    frame_id = frame_of(message)
    if not np.isfinite(K).all() or K[0, 0] <= 0 or K[1, 1] <= 0:
        raise CalibrationError(
            f"the camera_info of '{frame_id}' has no focal length: the camera is not calibrated; "
            "give --calibration FILE"
        )
    size = int(message.width), int(message.height)
    numbers = np.concatenate([D, R.ravel(), P.ravel()])
    if not np.isfinite(numbers).all() or min(size) < 1 or size[0] * size[1] > _LARGEST_PX:
        raise CalibrationError(
            f"the camera_info of '{frame_id}' cannot be: it is of {size[0]}x{size[1]} px, with D "
            f"{D.tolist()} and P {P.ravel().tolist()}; give --calibration FILE"
        )
    if P[0, 0] <= 0:
        P = np.hstack((K, np.zeros((3, 1))))
    return CameraInfo(
        K=K,
        D=D if D.size else np.zeros(5),
        R=R if R.any() else np.eye(3),
        P=P,
        size=size,
        model=str(message.distortion_model),
        frame_id=frame_id,
    )


def frame_of(stamped: Any) -> str:
    """The frame of a message's header; tf2 knows no leading slash."""
    return str(stamped.header.frame_id).lstrip("/")


def rectifying_maps(info: CameraInfo) -> tuple[Any, Any] | None:
    """Maps for `cv2.remap` from raw to rectified images; None where they are the same."""
    if info.is_undistorted:
        return None
    K_rectified = info.K_rectified
    if info.is_fisheye:
        return cv2.fisheye.initUndistortRectifyMap(
            info.K, info.D[:4], info.R, K_rectified, info.size, cv2.CV_32FC1
        )
    return cv2.initUndistortRectifyMap(info.K, info.D, info.R, K_rectified, info.size, cv2.CV_32FC1)


def _numbers(message: Any, name: str) -> Floats:
    """A field that is written small in ROS 2 and large in ROS 1."""
    value = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
    return np.asarray(value, np.float64)
