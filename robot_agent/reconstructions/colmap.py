"""COLMAP's result (Schönberger and Frahm 2016): `cameras`, `images` and `points3D`, text or binary,
as its manual describes them.
"""

from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions import colmap_binary, colmap_text
from fleetpose.robot_agent.reconstructions.colmap_records import (
    CAMERA_MODELS,
    ColmapCamera,
    ColmapImage,
)
from fleetpose.robot_agent.reconstructions.model import Floats, Indices, Reconstruction
from fleetpose.robot_agent.reconstructions.photos import Photo, pose_of, reconstruction_of

_FILES = ("cameras.bin", "cameras.txt")  # in the order in which COLMAP looks
_MODEL_FOLDERS = ("", "sparse/0", "sparse", "dense/sparse")
_FIRST_PIXEL = 0.5  # where its middle is; ours is at 0
_NO_POINT = -1  # of a keypoint
_OPENCVS_FEWEST = 4  # k1, k2, p1, p2


def find_colmap(path: Path) -> list[Path]:
    """The file of cameras of the first model in a folder; the path itself if it is such a file."""
    if path.name in _FILES and path.is_file():
        return [path]
    files = (path / folder / name for folder in _MODEL_FOLDERS for name in _FILES)
    return [file for file in files if file.is_file()][:1]


def read_colmap(cameras: Path, only: str | None = None) -> Reconstruction:
    """Reads a model; its images lie in `images` or beside it, or there above `sparse` and `dense`.

    Args:
        cameras: its file of cameras.
        only: name of the one image to take, with or without its ending; all if not given.

    Raises:
        DataFolderError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    folder = cameras.parent
    files = colmap_binary if cameras.suffix == ".bin" else colmap_text
    try:
        by_id = files.read_cameras(cameras)
        images = files.read_images(folder / f"images{cameras.suffix}")
        points = files.read_points(folder / f"points3D{cameras.suffix}")
    except (ValueError, OverflowError) as error:
        raise DataFolderError(f"{folder} holds no model of COLMAP: {error}") from error
    numbers = {point: number for number, point in enumerate(points.ids.tolist())}
    photos = [
        _photo(folder, image, by_id.get(image.camera), numbers)
        for image in sorted(images, key=lambda image: image.name)
    ]
    return reconstruction_of(folder, photos, points.xyz, points.colours, _places(folder), only)


def _photo(
    source: Path, image: ColmapImage, camera: ColmapCamera | None, numbers: dict[int, int]
) -> Photo:
    """An image whose points have numbers instead of ids."""
    if camera is None:
        raise DataFolderError(f"{source} has no camera {image.camera}, which {image.name} needs")
    focal_count, distortion_count = CAMERA_MODELS[camera.model]
    parameters = camera.parameters
    if len(parameters) != focal_count + 2 + distortion_count:
        raise DataFolderError(f"{source}: {len(parameters)} parameters of a {camera.model} camera")
    focal_px = np.broadcast_to(parameters[:focal_count], 2)
    centre, distortion = parameters[focal_count:][:2], parameters[focal_count + 2 :]
    distortion = np.pad(distortion, (0, max(0, _OPENCVS_FEWEST - len(distortion))))
    seen, at = _seen(source, image, numbers)
    T = pose_of(image.pose[:4], image.pose[4:])
    return Photo(
        image.name, focal_px, distortion, T, seen, at - centre, centre - _FIRST_PIXEL, camera.size
    )


def _seen(source: Path, image: ColmapImage, numbers: dict[int, int]) -> tuple[Indices, Floats]:
    """(N,) which points it saw, and (N, 2) where."""
    kept = image.points != _NO_POINT
    try:
        seen = [numbers[point] for point in image.points[kept].tolist()]
    except KeyError as error:
        raise DataFolderError(f"{source}: {image.name} saw point {error}, which is none") from error
    return np.array(seen, np.int64), image.at[kept]


def _places(folder: Path) -> list[Path]:
    """Where images may lie: those of a dense model are not those of the sparse one above it."""
    folder = folder.absolute()
    places = [folder / "images", folder]
    while folder.name in ("sparse", "dense") or folder.name.isdecimal():
        folder = folder.parent
        places += [folder / "images", folder]
    return places
