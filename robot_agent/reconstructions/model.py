"""A reconstruction: cameras, points, and which camera saw which point where."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from protocol.errors import DataFolderError

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ReconstructedView:
    """One image of a reconstruction; its camera has OpenCV axes, and no distortion any more.

    Attributes:
        name: of the image.
        image: its file.
        width, height: px.
        K: (3, 3) of the undistorted image.
        radial: k1 and k2 of the image as it is in the file.
        T_camera_world: (4, 4).
        seen: (N,) which points it saw.
        uv: (N, 2) where, px of the undistorted image.
    """

    name: str
    image: Path
    width: int
    height: int
    K: Floats
    radial: tuple[float, float]
    T_camera_world: Floats
    seen: Indices
    uv: Floats

    def picture(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) BGR, undistorted.

        Raises:
            DataFolderError: it cannot be read.
        """
        picture = cv2.imread(str(self.image), cv2.IMREAD_COLOR)
        if picture is None:
            raise DataFolderError(f"{self.image} is no image, or is missing")
        return np.asarray(cv2.undistort(picture, self.K, np.array([*self.radial, 0, 0])), np.uint8)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Views and points (P, 3) of the world, in the reconstruction's unit, with colours (P, 3)."""

    views: tuple[ReconstructedView, ...]
    points: Floats
    colours: npt.NDArray[np.uint8]

    def scaled(self, metres_per_unit: float) -> "Reconstruction":
        """The same in metres."""
        views = []
        for view in self.views:
            T = view.T_camera_world.copy()
            T[:3, 3] *= metres_per_unit
            views.append(replace(view, T_camera_world=T))
        return Reconstruction(tuple(views), self.points * metres_per_unit, self.colours)

    def in_camera(self, view: ReconstructedView) -> Floats:
        """(N, 3) the points that a view saw, in its camera frame."""
        T = view.T_camera_world
        return self.points[view.seen] @ T[:3, :3].T + T[:3, 3]

    @cached_property
    def reprojection_px(self) -> Floats:
        """Of all points in all views: how far from where they were seen they project."""
        return np.concatenate([np.zeros(0), *(self._off_px(view) for view in self.views)])

    def _off_px(self, view: ReconstructedView) -> Floats:
        p = self.in_camera(view)
        front = p[:, 2] > 0
        projected = p[front] @ view.K.T
        return np.linalg.norm(projected[:, :2] / projected[:, 2:] - view.uv[front], axis=1)


def undistorted(uv: Floats, K: Floats, radial: tuple[float, float]) -> Floats:
    """Pixels (N, 2) of a distorted image as pixels of the undistorted one with the same K."""
    if len(uv) == 0:
        return np.zeros((0, 2))
    distortion = np.array([*radial, 0.0, 0.0])
    turned = cv2.undistortPoints(np.ascontiguousarray(uv[:, None]), K, distortion, P=K)
    return np.asarray(turned, np.float64).reshape(-1, 2)


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file.

    Raises:
        DataFolderError: it is missing or no image.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if picture is None:
        raise DataFolderError(f"{path} is no image, or is missing")
    height, width = picture.shape
    return width, height
