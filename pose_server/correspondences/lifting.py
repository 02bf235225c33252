"""From a clicked pixel to a 3D point, in the view it was clicked in.

A person clicks several times in the same two images, and never waits for a click: the clouds of the
last clicked views stay decoded, and of an organised one only the pixels around the click are looked
at where these suffice.
"""

from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.lift import LIFT, LiftedPoint, lift_pixel
from fleetpose.pose_server.registration.prepared_view import point_noise
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.clouds import (
    CLICK_REACH_CELLS,
    CLICK_REACH_PX,
    decode_scattered,
    depth_image,
    grid_to_pixel,
)
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import DepthCloud, View, ViewName

Floats = npt.NDArray[np.floating]

_CLOUDS = 8  # a megapixel each 4 MB
_WINDOW = 32  # cells to each side of the click


class NoDepthError(FleetPoseError):
    """A click where no point can be had."""


@dataclass(frozen=True)
class _Grid:
    """A depth image (H, W), metres, nan where there is none; a cell is `scale` pixels wide."""

    depth: npt.NDArray[np.float32]
    scale: int

    @property
    def radius_px(self) -> float:
        return CLICK_REACH_CELLS * self.scale

    def near(self, pixel: Floats) -> tuple[Floats, Floats]:
        """Pixels (N, 2) and depths (N,) of the cells around a pixel, or of all where there are too
        few for what is nearest to be among them.
        """
        column, row = (int((c + 0.5) // self.scale) for c in pixel)
        top, left = max(row - _WINDOW, 0), max(column - _WINDOW, 0)
        uv, z = self._points(top, left, row + _WINDOW + 1, column + _WINDOW + 1)
        inside = np.linalg.norm(uv - pixel, axis=1) <= _WINDOW * self.scale
        return (
            (uv, z)
            if np.count_nonzero(inside) >= LIFT.neighbours
            else self._points(0, 0, None, None)
        )

    def _points(
        self, top: int, left: int, bottom: int | None, right: int | None
    ) -> tuple[Floats, Floats]:
        window = self.depth[top:bottom, left:right]
        rows, columns = np.nonzero(np.isfinite(window))
        cells = np.column_stack((columns + left, rows + top))
        return grid_to_pixel(cells, self.scale), window[rows, columns].astype(np.float64)


@dataclass(frozen=True)
class _Scattered:
    """Pixels (N, 2) and depths (N,), metres."""

    uv: Floats
    z: Floats
    radius_px: float = CLICK_REACH_PX

    def near(self, pixel: Floats) -> tuple[Floats, Floats]:
        del pixel
        return self.uv, self.z


class Lifter:
    """Lifts clicks; keeps the clouds of the last views clicked in."""

    def __init__(self) -> None:
        self._clouds: OrderedDict[ViewName, _Grid | _Scattered] = OrderedDict()

    def lift(self, kept: KeptView, pixel: Floats) -> LiftedPoint:
        """The 3D point under a pixel (2,) of a view, camera frame, metres.

        Raises:
            NoDepthError: the pixel is outside the image or has no depth near it; the text says so.
        """
        camera = kept.camera
        if not (-0.5 <= pixel[0] <= camera.width - 0.5 and -0.5 <= pixel[1] <= camera.height - 0.5):
            raise NoDepthError(
                f"pixel ({pixel[0]:.0f}, {pixel[1]:.0f}) is outside the image "
                f"({camera.width}x{camera.height})"
            )
        cloud = self._cloud(kept)
        uv, z = cloud.near(pixel)
        try:
            return lift_pixel(pixel, uv, z, camera.K, point_noise(camera.noise), cloud.radius_px)
        except DegenerateGeometryError as error:
            raise NoDepthError(str(error)) from error

    def _cloud(self, kept: KeptView) -> _Grid | _Scattered:
        if kept.name not in self._clouds:
            self._clouds[kept.name] = self._decoded(kept)
            while len(self._clouds) > _CLOUDS:
                self._clouds.popitem(last=False)
        self._clouds.move_to_end(kept.name)
        return self._clouds[kept.name]

    @staticmethod
    def _decoded(kept: KeptView) -> _Grid | _Scattered:
        cloud = unpack(View, kept.payload).cloud
        if isinstance(cloud, DepthCloud):
            return _Grid(depth_image(cloud, kept.camera), cloud.scale)
        return _Scattered(*decode_scattered(cloud))
