"""Rectification: both images of a rig as two equal cameras side by side would see them."""

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.stereo.rig import Floats, StereoRig, laid_down

Image = npt.NDArray[np.uint8]


class Rectifier:
    """Warps both images so that the same point lies in the same row. Of cameras below each other
    both are turned by 90 deg.

    Attributes:
        size: width, height of the rectified images, px.
        K: (3, 3) intrinsics of both rectified images, px.
        baseline_m: between both cameras.
        T_robot_rectified: (4, 4) where the rectified left camera sits on the robot.
        R_rect_left, R_rect_right: (3, 3) each camera's own axes to the rectified ones.

    Raises:
        CalibrationError: the calibration cannot be rectified.
    """

    def __init__(self, rig: StereoRig) -> None:
        self._is_turned = rig.is_upright
        if self._is_turned:
            rig = laid_down(rig)
        self.size = rig.size
        self.K, self.baseline_m = rig.K_left, rig.baseline_m
        self.T_robot_rectified = rig.T_robot_left
        self.R_rect_left, self.R_rect_right = np.eye(3), np.eye(3)
        self._maps: list[tuple[npt.NDArray, npt.NDArray]] = []
        if rig.is_rectified:
            return
        R_rect_left, R_rect_right, P_left, P_right = _rectified(rig)
        self.K = np.array(P_left[:, :3], np.float64)
        self.baseline_m = -float(P_right[0, 3] / P_right[0, 0])
        self.R_rect_left, self.R_rect_right = np.array(R_rect_left), np.array(R_rect_right)
        _check_rectified(self.K, self.baseline_m, rig)
        T_left_rectified = np.eye(4)
        T_left_rectified[:3, :3] = self.R_rect_left.T
        self.T_robot_rectified = rig.T_robot_left @ T_left_rectified
        for K, D, R_rect, P in (
            (rig.K_left, rig.D_left, R_rect_left, P_left),
            (rig.K_right, rig.D_right, R_rect_right, P_right),
        ):
            self._maps.append(_maps(rig, K, D, R_rect, P))

    def left(self, image: Image) -> Image:
        """The left image (H, W) or (H, W, 3), rectified."""
        return self._warp(image, 0)

    def right(self, image: Image) -> Image:
        """The right image, likewise."""
        return self._warp(image, 1)

    def _warp(self, image: Image, side: int) -> Image:
        if self._is_turned:
            image = np.ascontiguousarray(np.rot90(image))
        if not self._maps:
            return image
        return np.asarray(cv2.remap(image, *self._maps[side], cv2.INTER_LINEAR), np.uint8)


def _rectified(rig: StereoRig) -> tuple[Floats, Floats, Floats, Floats]:
    """Rotations (3, 3) to the rectified axes and projections (3, 4), left, right, left, right."""
    R, t = rig.T_right_left[:3, :3].copy(), rig.T_right_left[:3, 3:].copy()  # as OpenCV wants it
    if rig.lens == "fisheye":
        found = cv2.fisheye.stereoRectify(
            rig.K_left, _four(rig.D_left), rig.K_right, _four(rig.D_right), rig.size, R, t,
            flags=cv2.CALIB_ZERO_DISPARITY, balance=0.0,
        )  # fmt: skip
    else:
        found = cv2.stereoRectify(
            rig.K_left, rig.D_left, rig.K_right, rig.D_right, rig.size, R, t,
            flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
        )  # fmt: skip
    R_left, R_right, P_left, P_right = (np.array(one, np.float64) for one in found[:4])
    return R_left, R_right, P_left, P_right


def _maps(
    rig: StereoRig, K: Floats, D: Floats, R: Floats, P: Floats
) -> tuple[npt.NDArray, npt.NDArray]:
    if rig.lens == "fisheye":
        return cv2.fisheye.initUndistortRectifyMap(K, _four(D), R, P[:, :3], rig.size, cv2.CV_32FC1)
    return cv2.initUndistortRectifyMap(K, D, R, P, rig.size, cv2.CV_32FC1)  # pyright: ignore[reportArgumentType]


def _four(D: Floats) -> Floats:
    return D.reshape(-1)[:4].reshape(4, 1)


def _check_rectified(K: Floats, baseline_m: float, rig: StereoRig) -> None:
    """Distortion or a rotation that cannot be leave hardly anything of the image, or turn it
    inside out.
    """
    zoom = K[0, 0] / rig.K_left[0, 0]
    if not np.isfinite(K).all() or baseline_m <= 0 or not 1 / 3 < zoom < 3:
        raise CalibrationError(
            f"the calibration cannot be rectified (zoom {zoom:.2g}, baseline {baseline_m:.3g} m): "
            "check R, t and the distortion, or calibrate again"
        )
