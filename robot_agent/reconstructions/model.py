"""A reconstruction: cameras, points, and which camera saw which point where."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Colours = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class ReconstructedView:
    """One image of a reconstruction; its camera has OpenCV axes, and no distortion any more.

    Attributes:
        name: of the image, with the folders below that of all images.
        image: its file.
        width, height: px.
        K: (3, 3) of the undistorted image.
        distortion: OpenCV's vector, of the image as it is in the file.
        T_camera_world: (4, 4).
        seen: (N,) which points it saw.
        uv: (N, 2) where, px of the undistorted image.
    """

    name: str
    image: Path
    width: int
    height: int
    K: Floats
    distortion: Floats
    T_camera_world: Floats
    seen: Indices
    uv: Floats

    def picture(self) -> npt.NDArray[np.uint8]:
        """(H, W, 3) BGR, undistorted; as the pixels lie in the file, whatever it says of up.

        Raises:
            DataFolderError: it cannot be read.
        """
        as_it_lies = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imread(str(self.image), as_it_lies)
        if picture is None:
            raise DataFolderError(f"{self.image} is no image, or is missing")
        return np.asarray(cv2.undistort(picture, self.K, self.distortion), np.uint8)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Views and points (P, 3) of the world, in the reconstruction's unit, with colours (P, 3)."""

    views: tuple[ReconstructedView, ...]
    points: Floats
    colours: Colours

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

    def measured(self, view: ReconstructedView) -> tuple[Indices, Floats, Floats]:
        """What a camera could measure there: the points (N,) before it whose pixels (N, 2) lie in
        the image, and (N, 3) where they are in its frame.
        """
        p = self.in_camera(view)
        inside = (view.uv >= -0.5) & (view.uv < (view.width - 0.5, view.height - 0.5))
        there = (p[:, 2] > 0) & inside.all(axis=1)
        return view.seen[there], view.uv[there], p[there]

    @cached_property
    def reprojection_px(self) -> Floats:
        """Of all points in all views: how far from where they were seen they project."""
        return np.concatenate([np.zeros(0), *(self._off_px(view) for view in self.views)])

    def _off_px(self, view: ReconstructedView) -> Floats:
        p = self.in_camera(view)
        front = p[:, 2] > 0
        projected = p[front] @ view.K.T
        return np.linalg.norm(projected[:, :2] / projected[:, 2:] - view.uv[front], axis=1)
