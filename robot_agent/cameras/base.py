"""What a camera is: a source of rectified frames with ranges."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from fleetpose.protocol.messages import Camera as CameraModel


class CameraError(FleetPoseError):
    """A camera's device or video is missing, busy, or has stopped; the sentence says what to do."""


class OtherKindError(DataFolderError):
    """A folder or file that is no recording of this kind of camera, and may be one of another."""


@dataclass(frozen=True)
class DepthImage:
    """Organised depth: (H, W) float32 metres along the optical axis, nan where there is none.

    `step_m` is the quantum it is sent with.
    """

    depth_m: npt.NDArray[np.float32]
    step_m: float = 0.001


@dataclass(frozen=True)
class DisparityImage:
    """Organised disparity: (H, W) float32 pixels, nan or <= 0 where there is none.

    z = focal_baseline / disparity.
    """

    disparity_px: npt.NDArray[np.float32]
    focal_baseline_px_m: float
    step_px: float = 1 / 16


@dataclass(frozen=True)
class ScatteredPoints:
    """Points without a grid: (N, 2) pixels and (N,) metres along the optical axis."""

    uv: npt.NDArray[np.float64]
    z: npt.NDArray[np.float64]


Ranges = DepthImage | DisparityImage | ScatteredPoints


@dataclass(frozen=True, eq=False)
class OdometryPose:
    """Where the robot is in its own odometry frame: T_odom_robot (4, 4), and its covariance (6, 6),
    left, rotation first; None where it is not known.
    """

    T_odom_robot: npt.NDArray[np.float64]
    covariance: npt.NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Frame:
    """One moment of one camera.

    Attributes:
        stamp_ns: UTC of the robot's clock.
        image: (H, W, 3) uint8 BGR, rectified, full resolution.
        ranges: what was measured, on the grid of the image. Where it is the same object as that of
            the frame before, nothing in sight has changed but the noise.
        model: intrinsics, extrinsics and noise of this very frame.
        up_camera: unit vector against gravity in the camera frame, where it is known.
        raw: the images as a live device gave them, of each eye; empty where they are recorded.
        odometry: of this moment, from a camera that knows it.
        has_image: whether the image is one; else it is drawn of the ranges, for operators.
        frozen_s: for how long these have been identical to the last bit; `FleetRobot` looks.
    """

    stamp_ns: int
    image: npt.NDArray[np.uint8]
    ranges: Ranges
    model: CameraModel
    up_camera: npt.NDArray[np.float64] | None = None
    up_sigma_rad: float | None = None
    raw: tuple[npt.NDArray[np.uint8], ...] = ()
    frozen_s: float = 0.0
    has_image: bool = True
    odometry: OdometryPose | None = None


class Camera(Protocol):
    """A source of frames; one file per kind."""

    def frames(self) -> Iterator[Frame]:
        """Yields frames as the camera has them; the agent sets the pace."""
        ...

    def close(self) -> None:
        """Releases the device."""
        ...
