"""What the simulated operator knows of recorded views: which pixels show the same point."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.data.rgbd import read_depth
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.simulate.operator import by_depth_images, by_tracks

DEPTH_FOLDER = "depth"
"""Of a posed-views folder whose depths are known at every pixel: 16-bit PNG, millimetres."""
_CORNERS, _CORNER_QUALITY, _CORNER_GAP_PX = 2000, 0.003, 5


def true_pixels(recording: Recording, i: TrueView, j: TrueView) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of view i and of view j that show the same N points.

    Where depths are known at every pixel, anything with contrast in view i that view j sees as
    well, whatever made the cloud; elsewhere the common tracks, for nothing else is known there.
    """
    depth_i, depth_j = true_depth(recording, i), true_depth(recording, j)
    if depth_i is not None and depth_j is not None:
        uv_i = with_contrast(i.image, (i.width, i.height))
        return by_depth_images(uv_i, depth_i, depth_j, i.K, j.K, j.T_to(i))
    tracks_i, tracks_j = recording.tracks(i), recording.tracks(j)
    if tracks_i is None or tracks_j is None:
        return np.zeros((0, 2)), np.zeros((0, 2))
    return by_tracks(*tracks_i, *tracks_j)


def true_depth(recording: Recording, view: TrueView) -> Floats | None:
    """(H, W) metres, nan where there is none; none where only single points are known."""
    path = view.cloud if recording.is_rgbd else recording.directory / DEPTH_FOLDER / view.name
    return _depth(path) if path is not None and path.exists() else None


@lru_cache(maxsize=64)
def _depth(path: Path) -> Floats:
    return read_depth(path)


@lru_cache(maxsize=512)
def with_contrast(image: Path, size: tuple[int, int]) -> Floats:
    """Pixels (N, 2) of an image that an operator can tell from what is around them."""
    grey = cv2.imread(str(image), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        return np.zeros((0, 2))
    grey = cv2.resize(grey, size) if grey.shape[::-1] != size else grey
    found = cv2.goodFeaturesToTrack(grey, _CORNERS, _CORNER_QUALITY, _CORNER_GAP_PX)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)
