"""COLMAP's result (Schönberger and Frahm 2016): `cameras`, `images` and `points3D`, text or binary,
as its manual describes them.
"""

from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.reconstructions import colmap_binary, colmap_text
from fleetpose.formats.reconstructions.colmap_records import (
    CAMERA_MODELS,
    ColmapCamera,
    ColmapImage,
    ColmapPoints,
)
from fleetpose.formats.reconstructions.photos import MOST_NAMED, Model, Photo
from fleetpose.formats.rotations import pose_of, quat_wxyz

CAMERA_FILES = ("cameras.bin", "cameras.txt")  # in the order in which COLMAP looks
_FIRST_PIXEL = 0.5  # where its middle is; ours is at 0
_NO_POINT = -1  # of a keypoint
_OPENCVS_FEWEST = 4  # k1, k2, p1, p2
_OPENCVS_MOST = 8  # and k3 to k6: COLMAP's FULL_OPENCV


def read_colmap(cameras: Path) -> Model:
    """Reads a model; its photos are in the order of their names.

    Args:
        cameras: its file of cameras.

    Raises:
        FormatError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    folder = cameras.parent
    files = colmap_binary if cameras.suffix == ".bin" else colmap_text
    try:
        by_id = files.read_cameras(cameras)
        images = files.read_images(folder / f"images{cameras.suffix}")
        points = files.read_points(folder / f"points3D{cameras.suffix}")
    except FormatError:
        raise
    except (ValueError, OverflowError) as error:
        raise FormatError(f"{folder} holds no model of COLMAP: {error}") from error
    numbers = {point: number for number, point in enumerate(points.ids.tolist())}
    photos = [
        _photo(folder, image, by_id.get(image.camera), numbers)
        for image in sorted(images, key=lambda image: image.name)
    ]
    return Model(tuple(photos), points.xyz, points.colours)


def write_colmap(folder: Path, model: Model, binary: bool = False) -> None:
    """Writes the three files of a model into a folder that is there.

    Cameras that are alike are one. Points keep their order, photos too.

    Raises:
        FormatError: the size or the principal point of a photo is not known, or its name cannot be
            written; the text names it.
        OSError: a file cannot be written.
    """
    cameras: dict[tuple[object, ...], tuple[int, ColmapCamera]] = {}
    images = []
    for photo in model.photos:
        camera = _camera(photo)
        alike = (camera.model, camera.size, camera.parameters.tobytes())
        number, _ = cameras.setdefault(alike, (len(cameras) + 1, camera))
        T = photo.T_camera_world
        pose = np.array([*quat_wxyz(T[:3, :3]), *T[:3, 3]])
        at = photo.at + _principal(photo)
        images.append(ColmapImage(_name(photo), number, pose, at, photo.seen + 1))
    ending, files = ("bin", colmap_binary) if binary else ("txt", colmap_text)
    files.write_cameras(folder / f"cameras.{ending}", dict(cameras.values()))
    files.write_images(folder / f"images.{ending}", images)
    colours = np.clip(np.rint(model.colours), 0, 255)
    points = ColmapPoints(np.arange(1, len(model.points) + 1), model.points, colours)
    tracks: list[list[tuple[int, int]]] = [[] for _ in model.points]
    for number, photo in enumerate(model.photos, 1):
        for keypoint, point in enumerate(photo.seen.tolist()):
            tracks[point].append((number, keypoint))
    files.write_points(folder / f"points3D.{ending}", points, _mean_errors_px(model), tracks)


def _camera(photo: Photo) -> ColmapCamera:
    if photo.size is None:
        raise FormatError(f"{photo.name[:MOST_NAMED]}: COLMAP needs the size of its image")
    centre = _principal(photo)
    if not photo.distortion.any():
        return ColmapCamera("PINHOLE", photo.size, np.array([*photo.focal_px, *centre]))
    distortion = photo.distortion
    model = "OPENCV" if len(distortion) == _OPENCVS_FEWEST else "FULL_OPENCV"
    if len(distortion) not in (_OPENCVS_FEWEST, _OPENCVS_MOST):
        raise FormatError(f"{photo.name[:MOST_NAMED]}: {len(distortion)} distortion parameters")
    return ColmapCamera(model, photo.size, np.array([*photo.focal_px, *centre, *distortion]))


def _principal(photo: Photo) -> Floats:
    """(2,) the principal point as COLMAP counts pixels."""
    if photo.centre is not None:
        return photo.centre + _FIRST_PIXEL
    if photo.size is None:
        raise FormatError(f"{photo.name[:MOST_NAMED]}: COLMAP needs the size of its image")
    return 0.5 * np.array(photo.size)


def _name(photo: Photo) -> str:
    plain = photo.name.strip() == photo.name and photo.name
    if not plain or set(photo.name) & set("\0\r\n"):
        raise FormatError(f"image {photo.name[:MOST_NAMED]!r}: give it a plain name")
    return photo.name


def _mean_errors_px(model: Model) -> Floats:
    """(P,) mean reprojection error of each point over the undistorted photos that saw it; -1, as
    COLMAP has it, where there is none.
    """
    total, count = np.zeros(len(model.points)), np.zeros(len(model.points))
    for photo in model.photos:
        T = photo.T_camera_world
        p = model.points[photo.seen] @ T[:3, :3].T + T[:3, 3]
        good = (p[:, 2] > 0) & (not photo.distortion.any())
        off = photo.focal_px * p[good, :2] / p[good, 2:] - photo.at[good]
        np.add.at(total, photo.seen[good], np.linalg.norm(off, axis=1))
        np.add.at(count, photo.seen[good], 1)
    return np.where(count > 0, total / np.maximum(count, 1), -1.0)


def _photo(
    source: Path, image: ColmapImage, camera: ColmapCamera | None, numbers: dict[int, int]
) -> Photo:
    """An image whose points have numbers instead of ids."""
    if camera is None:
        raise FormatError(f"{source} has no camera {image.camera}, which {image.name} needs")
    focal_count, distortion_count = CAMERA_MODELS[camera.model]
    parameters = camera.parameters
    if len(parameters) != focal_count + 2 + distortion_count:
        raise FormatError(f"{source}: {len(parameters)} parameters of a {camera.model} camera")
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
        raise FormatError(f"{source}: {image.name} saw point {error}, which is none") from error
    return np.array(seen, np.int64), image.at[kept]


def image_folders(cameras: Path) -> list[Path]:
    """Where images of a model may lie: in `images` or beside it, or there above `sparse` and
    `dense`; those of a dense model are not those of the sparse one above it.
    """
    folder = cameras.parent.absolute()
    places = [folder / "images", folder]
    while folder.name in ("sparse", "dense") or folder.name.isdecimal():
        folder = folder.parent
        places += [folder / "images", folder]
    return places
