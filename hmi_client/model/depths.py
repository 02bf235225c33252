"""Where a view has depth: what an operator's click needs, and what it can be snapped to."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.records import PixelUV
from fleetpose.protocol.clouds import (
    CLICK_REACH_CELLS,
    CLICK_REACH_PX,
    decode_scattered,
    depth_image,
    grid_to_pixel,
)
from fleetpose.protocol.messages import DepthCloud, View, ViewName
from fleetpose.protocol.messages.camera import Camera

Floats = npt.NDArray[np.float64]
_WINDOW = 24  # cells to each side that are searched for the nearest depth


@dataclass(frozen=True)
class DepthPoint:
    """The nearest point with depth: its pixel, its depth in metres, and how far it is, px."""

    pixel: PixelUV
    z: float
    distance_px: float


@dataclass(frozen=True)
class Depths:
    """The points with depth of one view.

    Attributes:
        view: which.
        camera: its camera.
        uv: (N, 2) pixels of scattered points; none of an organised cloud.
        z: (N,) their depths, or (H, W) those of an organised cloud, nan where there is none; m.
        scale: full-resolution pixels per cell of an organised cloud.
    """

    view: ViewName
    camera: Camera
    uv: Floats
    z: npt.NDArray[np.floating] = field(repr=False)
    scale: int = 1

    @classmethod
    def of(cls, view: View) -> "Depths":
        """Decodes the cloud of a view.

        Raises:
            CodecError: it is damaged.
        """
        cloud = view.cloud
        if isinstance(cloud, DepthCloud):
            depth = depth_image(cloud, view.camera)
            return cls(view.name, view.camera, np.zeros((0, 2)), depth, cloud.scale)
        uv, z = decode_scattered(cloud)
        return cls(view.name, view.camera, uv, z)

    @property
    def scattered(self) -> bool:
        """Whether only some pixels have depth, so that these are worth showing."""
        return self.z.ndim == 1

    @property
    def reach_px(self) -> float:
        """How far from a point with depth the server takes a click."""
        return CLICK_REACH_PX if self.scattered else CLICK_REACH_CELLS * self.scale

    def nearest(self, pixel: PixelUV) -> DepthPoint | None:
        """The point with depth nearest to a pixel; none if there is none (near it)."""
        uv, z = (self.uv, self.z) if self.scattered else self._around(pixel)
        if not len(z):
            return None
        distances = np.linalg.norm(uv - pixel, axis=1)
        at = int(np.argmin(distances))
        return DepthPoint((float(uv[at, 0]), float(uv[at, 1])), float(z[at]), float(distances[at]))

    def has(self, pixel: PixelUV) -> bool:
        """Whether a click there can be lifted."""
        nearest = self.nearest(pixel)
        return nearest is not None and nearest.distance_px <= self.reach_px

    def lift(self, pixel: PixelUV) -> Floats | None:
        """(3,) the point under a pixel in the camera frame, metres, at the depth of the nearest
        one; none where there is no depth. For drawing: the server lifts clicks with more care.
        """
        nearest = self.nearest(pixel)
        if nearest is None or nearest.distance_px > self.reach_px:
            return None
        return nearest.z * (np.linalg.inv(self.camera.K) @ (*pixel, 1.0))

    def within(self, u: float, v: float, du: float, dv: float) -> list[PixelUV]:
        """The scattered points around a pixel."""
        near = (np.abs(self.uv - (u, v)) <= (du, dv)).all(axis=1)
        return [(a, b) for a, b in self.uv[near].tolist()]

    def depth_range(self) -> tuple[float, float]:
        """What most depths lie between, metres."""
        z = self.z[np.isfinite(self.z)]
        low, high = np.percentile(z, (5, 95)) if z.size else (1.0, 10.0)
        return float(low), float(high)

    def _around(self, pixel: PixelUV) -> tuple[Floats, npt.NDArray[np.floating]]:
        column, row = (int((c + 0.5) // self.scale) for c in pixel)
        top, left = max(row - _WINDOW, 0), max(column - _WINDOW, 0)
        window = self.z[top : row + _WINDOW + 1, left : column + _WINDOW + 1]
        rows, columns = np.nonzero(np.isfinite(window))
        cells = np.column_stack((columns + left, rows + top))
        return grid_to_pixel(cells, self.scale), window[rows, columns]
