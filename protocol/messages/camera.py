"""What a camera is, on the wire: part of `protocol.messages`, and imported from there."""

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from fleetpose.protocol.messages.arrays import Matrix3, Pose
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import Name, Positive

Sigma = Annotated[float, Field(ge=0, le=1e3)]


class NoiseModel(Message, frozen=True, schema="fleet.noise_model.v1"):
    """How well a camera measures points: covariances are long along the ray and thin across."""

    pixel_sigma_px: Annotated[float, Field(ge=1e-3, le=1e3)] = Field(
        description="sigma of a salient point in the image"
    )
    depth_sigma_m: tuple[Sigma, Sigma, Sigma] = Field(
        description="c0, c1, c2 of sigma(z) = c0 + c1 z + c2 z^2 along the ray, metres"
    )
    focal_baseline_px_m: Positive | None = Field(
        default=None, description="focal length x baseline of a stereo rig; none for other sensors"
    )

    @model_validator(mode="after")
    def _not_exact(self) -> "NoiseModel":
        if sum(self.depth_sigma_m) < 1e-9:
            raise ValueError("no camera measures depth without noise: give c0, c1 or c2")
        return self

    @classmethod
    def stereo(
        cls, focal_px: float, baseline_m: float, disparity_sigma_px: float, pixel_sigma_px: float
    ) -> "NoiseModel":
        """sigma(z) = z^2 / (f b) * disparity sigma."""
        fb = focal_px * baseline_m
        return cls(
            pixel_sigma_px=pixel_sigma_px,
            depth_sigma_m=(0.0, 0.0, disparity_sigma_px / fb),
            focal_baseline_px_m=fb,
        )


class Camera(Message, frozen=True, schema="fleet.camera.v1"):
    """`robot/<id>/camera`, latched, and inside every view, so that a view can be read alone."""

    width: Annotated[int, Field(gt=0, le=16384)]
    height: Annotated[int, Field(gt=0, le=16384)]
    K: Matrix3 = Field(description="pinhole intrinsics of the rectified full-resolution image, px")
    T_robot_camera: Pose = Field(description="camera extrinsics in the robot's body frame")
    noise: NoiseModel
    kind: Name = Field(description="what measures: stereo, rgbd, views, ...")

    @model_validator(mode="after")
    def _pinhole(self) -> "Camera":
        K = self.K
        if K[0, 0] <= 0 or K[1, 1] <= 0 or K[1, 0] or K[2, 0] or K[2, 1] or K[2, 2] != 1:
            raise ValueError("K is no pinhole matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]]")
        size = np.array((self.width, self.height))
        f, c = K[[0, 1], [0, 1]], K[:2, 2]
        if not (f > 0.05 * size.max()).all() or not (f < 200 * size.max()).all():
            raise ValueError(f"focal lengths {f} px are of no camera of {size} px")
        if (np.abs(c) > 10 * size).any() or abs(K[0, 1]) > f[0]:
            raise ValueError(f"centre {c} or skew {K[0, 1]:g} px are of no camera of {size} px")
        return self


ROBOT_FROM_CAMERA = np.array(
    [[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""`T_robot_camera` of a camera that looks along the robot's x axis (body: x forward, y left, z up).
"""
