"""A folder of RGB-D frames: `camera-intrinsics.txt`, `frame-*.depth.png`, `frame-*.pose.txt`."""

import re
from pathlib import Path

import numpy as np

from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats, nearest_rotation, rigid
from fleetpose.protocol.errors import DataFolderError

DEPTH_UNIT_M = 0.001


_NO_DEPTH = 65535  # written by some Kinect recordings beside 0


def read_depth(path: Path) -> Floats:
    """(H, W) metres from a 16-bit millimetre PNG, nan where there is none."""
    import cv2

    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2:
        raise DataFolderError(f"{path} is no 16-bit depth image")
    return np.where((raw == 0) | (raw == _NO_DEPTH), np.nan, raw * DEPTH_UNIT_M)


def open_rgbd(directory: Path) -> Recording:
    """Opens such a folder; frames without a pose are left out."""
    K = _matrix(directory / "camera-intrinsics.txt", (3, 3))
    depths = sorted(directory.glob("frame-*.depth.png"))
    if not depths:
        raise DataFolderError(f"{directory} has no frame-*.depth.png")
    width, height = _image_size(depths[0])
    views = []
    for index, depth in enumerate(depths):
        name = re.sub(r"\.depth\.png$", "", depth.name)
        pose = _matrix(directory / f"{name}.pose.txt", (4, 4))
        if not np.isfinite(pose).all():
            continue  # tracking was lost: such a frame has no truth, the others keep their places
        views.append(
            TrueView(
                index=index,
                name=name,
                image=_colour_image(directory, name),
                cloud=depth,
                width=width,
                height=height,
                K=K,
                T_world_camera=rigid(nearest_rotation(pose[:3, :3]), pose[:3, 3]),
            )
        )
    return Recording(directory, None, tuple(views))


def _colour_image(directory: Path, name: str) -> Path:
    for ending in ("color_registered.jpg", "color.jpg"):
        path = directory / f"{name}.{ending}"
        if path.exists():
            return path
    raise DataFolderError(f"{directory}/{name} has no colour image")


def _image_size(path: Path) -> tuple[int, int]:
    height, width = read_depth(path).shape
    return width, height


def _matrix(path: Path, shape: tuple[int, int]) -> Floats:
    try:
        return np.loadtxt(path).reshape(shape)
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} is no {shape[0]}x{shape[1]} matrix: {error}") from error
