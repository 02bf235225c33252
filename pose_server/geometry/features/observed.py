"""The salient points of one view as the geometry sees them."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.matching import PixelGrid, Prediction
from fleetpose.pose_server.geometry.se3 import transform

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Observed:
    """Salient points of one view.

    Attributes:
        K: (3, 3) intrinsics, px.
        size: (width, height), px.
        uv: (N, 2) pixels.
        inverse_depth: (N,) 1/m, nan where the point has no depth.
        inverse_depth_sigma: (N,) 1/m, nan where the point has no depth.
        pixel_sigma_px: sigma of a salient point in the image.
    """

    K: Floats
    size: tuple[int, int]
    uv: Floats
    inverse_depth: Floats
    inverse_depth_sigma: Floats
    pixel_sigma_px: float

    @cached_property
    def points(self) -> Floats:
        """(N, 3) in the camera frame, metres; nan where the point has no depth."""
        homogeneous = np.column_stack((self.uv, np.ones(len(self.uv))))
        return (homogeneous @ np.linalg.inv(self.K).T) / self.inverse_depth[:, None]

    @cached_property
    def lifted(self) -> npt.NDArray[np.int64]:
        """Indices of the points that have a depth."""
        return np.nonzero(np.isfinite(self.inverse_depth))[0]

    @cached_property
    def grid(self) -> PixelGrid:
        """Of the pixels."""
        return PixelGrid.of(self.uv)

    def with_points(self, points: Floats, depth_sigma: float) -> "Observed":
        """The same with more points (M, 3) behind its own; the sigma is a share of their depth."""
        inverse_depth = 1.0 / points[:, 2]
        return replace(
            self,
            uv=np.concatenate((self.uv, self.project(points)[0])),
            inverse_depth=np.concatenate((self.inverse_depth, inverse_depth)),
            inverse_depth_sigma=np.concatenate(
                (self.inverse_depth_sigma, depth_sigma * inverse_depth)
            ),
        )

    @property
    def focal_px(self) -> float:
        """Focal length along x."""
        return float(self.K[0, 0])

    def project(self, points: Floats) -> tuple[Floats, Floats]:
        """Pixels (N, 2) and depths (N,) of points in this camera's frame; meaningless where the
        depth is not positive.
        """
        z = points[:, 2]
        safe = np.where(z > 0, z, np.inf)
        uv = (points @ self.K.T)[:, :2] / safe[:, None]
        return uv, z

    def inside(self, uv: Floats, margin_px: float = 0.0) -> npt.NDArray[np.bool_]:
        """Which pixels (N, 2) fall into the image widened by a margin."""
        width, height = self.size
        u, v = uv[:, 0], uv[:, 1]
        return (
            (u >= -margin_px)
            & (v >= -margin_px)
            & (u <= width - 1 + margin_px)
            & (v <= height - 1 + margin_px)
        )

    def predict_in(self, other: "Observed", T_other_self: Floats, margin_px: float) -> Prediction:
        """Where this view's lifted points should appear in another view."""
        moved = transform(T_other_self, self.points[self.lifted])
        uv, z = other.project(moved)
        seen = (z > 1e-6) & other.inside(uv, margin_px)
        return Prediction(self.lifted[seen], uv[seen], 1.0 / z[seen])
