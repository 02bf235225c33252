"""A calibrated stereo pair.

Conventions are those of `cv2.stereoCalibrate`: `R` and `t` map points of the left camera to the
right one, `x_right = R x_left + t`, t in metres, so the first coordinate of t is minus the
baseline. Images are given unrectified with their distortion, or rectified with none.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA
from fleetpose.robot_agent.cameras.calibrations.lens import LensModel

Floats = npt.NDArray[np.float64]

MAX_BASELINE_M = 5.0


@dataclass(frozen=True)
class StereoRig:
    """Two cameras fixed to each other.

    Attributes:
        K_left, K_right: (3, 3) pinhole intrinsics, px.
        D_left, D_right: distortion, OpenCV's 4, 5, 8, 12 or 14 coefficients, 4 of a fisheye; zeros
            for none.
        T_right_left: (4, 4) points of the left camera to the right one, metres.
        size: width, height of both images, px.
        T_robot_left: (4, 4) where the left camera sits on the robot.
        lens: which model the distortion is of.

    Raises:
        CalibrationError: such a rig cannot be; the sentence says what to fix.
    """

    K_left: Floats
    D_left: Floats
    K_right: Floats
    D_right: Floats
    T_right_left: Floats
    size: tuple[int, int]
    T_robot_left: Floats = field(default_factory=lambda: ROBOT_FROM_CAMERA.copy())
    lens: LensModel = "normal"

    def __post_init__(self) -> None:
        for name in ("K_left", "K_right"):
            _check_pinhole(name, getattr(self, name), self.size)
        for name in ("D_left", "D_right"):
            D = getattr(self, name)
            counts = (4,) if self.lens == "fisheye" and D.any() else (4, 5, 8, 12, 14)
            if D.size not in counts or not np.isfinite(D).all():
                wanted = " or ".join(map(str, counts))
                raise CalibrationError(
                    f"{name} has {D.size} numbers: give {wanted}, zeros for none"
                )
        for name in ("T_right_left", "T_robot_left"):
            _check_rigid(name, getattr(self, name))
        _check_baseline(self.T_right_left[:3, 3])

    @property
    def baseline_m(self) -> float:
        """Distance of the two cameras."""
        return float(np.linalg.norm(self.T_right_left[:3, 3]))

    @property
    def is_upright(self) -> bool:
        """Whether the second camera stands below the first."""
        t = self.T_right_left[:3, 3]
        return bool(abs(t[1]) > abs(t[0]))

    @property
    def is_rectified(self) -> bool:
        """Whether the images need no rectification."""
        T = self.T_right_left
        sideways = np.eye(4)
        sideways[0, 3] = T[0, 3]
        undistorted = self.lens == "normal" and not self.D_left.any() and not self.D_right.any()
        return (
            undistorted
            and np.array_equal(self.K_left, self.K_right)
            and np.allclose(T, sideways, atol=1e-9)
        )


def laid_down(rig: StereoRig) -> StereoRig:
    """An upright rig as one side by side: both cameras turned by 90 deg about their axes, for
    images that `np.rot90` has turned.

    Raises:
        CalibrationError: its lenses have terms that are not turned here.
    """
    if rig.lens == "normal" and max(rig.D_left.size, rig.D_right.size) > 8:
        raise CalibrationError("cameras below each other need 8 terms of distortion at most")
    Q = np.eye(4)
    Q[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]  # x' points down, y' to the left
    width, height = rig.size
    return StereoRig(
        _turned(rig.K_left, width),
        _turned_lens(rig.D_left, rig.lens),
        _turned(rig.K_right, width),
        _turned_lens(rig.D_right, rig.lens),
        Q @ rig.T_right_left @ Q.T,
        (height, width),
        rig.T_robot_left @ Q.T,
        rig.lens,
    )


def _turned(K: Floats, width: int) -> Floats:
    return np.array([[K[1, 1], 0, K[1, 2]], [0, K[0, 0], width - 1 - K[0, 2]], [0, 0, 1]])


def _turned_lens(D: Floats, lens: LensModel) -> Floats:
    """The tangential terms change places; radial ones know no direction."""
    D = D.reshape(-1).copy()
    if lens == "normal":
        D[2], D[3] = -D[3], D[2]
    return D


def content_of(rig: StereoRig) -> dict[str, Any]:
    """The rig as stereo.json has it, without its place on the robot."""
    return {
        "distortion_model": {"normal": "radtan", "fisheye": "equidistant"}[rig.lens],
        "width": rig.size[0],
        "height": rig.size[1],
        "K_left": rig.K_left.tolist(),
        "D_left": rig.D_left.tolist(),
        "K_right": rig.K_right.tolist(),
        "D_right": rig.D_right.tolist(),
        "R": rig.T_right_left[:3, :3].tolist(),
        "t": rig.T_right_left[:3, 3].tolist(),
    }


def _check_pinhole(name: str, K: Floats, size: tuple[int, int]) -> None:
    largest = max(size)
    if not 0 < largest <= 16384:
        raise CalibrationError(f"images of {size[0]}x{size[1]} px: give width and height")
    if min(K[0, 0], K[1, 1]) < 0:
        raise CalibrationError(
            f"{name} has fx {K[0, 0]:g} and fy {K[1, 1]:g}: a focal length below 0 (a way of "
            "turning an axis round) is none: write it without the minus"
        )
    inside = np.isfinite(K).all() and 0 < K[0, 2] < size[0] and 0 < K[1, 2] < size[1]
    if not inside or K[0, 0] <= 0 or K[1, 1] <= 0 or K[2].tolist() != [0, 0, 1] or K[1, 0] != 0:
        raise CalibrationError(
            f"{name} is no pinhole matrix of a {size[0]}x{size[1]} image: it needs [[fx, 0, cx], "
            f"[0, fy, cy], [0, 0, 1]] in pixels, and has {K.tolist()}"
        )
    if not (0.05 * largest < min(K[0, 0], K[1, 1]) and max(K[0, 0], K[1, 1]) < 200 * largest):
        raise CalibrationError(
            f"{name} has focal lengths {K[0, 0]:g} and {K[1, 1]:g}: they must be in pixels"
        )


def _check_rigid(name: str, T: Floats) -> None:
    R = T[:3, :3]
    if not np.isfinite(T).all() or np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0:
        raise CalibrationError(f"the rotation of {name} is not orthonormal")


def _check_baseline(t: Floats) -> None:
    baseline = float(np.linalg.norm(t))
    if baseline < 1e-4:
        raise CalibrationError("the baseline is zero: t must be the way from left to right camera")
    if baseline > MAX_BASELINE_M:
        raise CalibrationError(
            f"the baseline is {baseline:g} m: t must be in metres, or its unit be told "
            "(--translation-unit)"
        )
    if abs(t[1]) > 0.9 * baseline:
        if t[1] > 0:
            raise CalibrationError(
                f"t = {np.round(t, 4).tolist()} puts the second camera above the first: give the "
                "upper one as the left one"
            )
        return
    if abs(t[0]) < 0.9 * baseline:
        raise CalibrationError(
            f"t = {np.round(t, 4).tolist()} does not point sideways or down: only cameras beside "
            "or below each other are supported"
        )
    if t[0] > 0:
        raise CalibrationError(
            f"t = {np.round(t, 4).tolist()} puts the right camera on the left: swap the cameras, "
            "or give R and t that map left to right (x_right = R x_left + t)"
        )
