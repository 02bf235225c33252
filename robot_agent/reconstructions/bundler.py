"""Bundler's result (Snavely et al. 2006): `bundle.out` with the images, as its manual describes it.

Its cameras look down their negative z axis, y is up, and pixels count from the middle of the image:
p = -P / P.z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p. A camera of focal length 0 was not registered.
"""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from protocol.errors import DataFolderError
from robot_agent.reconstructions.model import (
    Floats,
    ReconstructedView,
    Reconstruction,
    image_size,
    undistorted,
)

BUNDLE, LIST = "bundle.out", "list.txt"
_MAGIC = "# Bundle file"
_CAMERA_NUMBERS, _POINT_NUMBERS = 15, 6
_TURN = np.diag([1.0, -1.0, -1.0])  # from Bundler's axes to OpenCV's
_IMAGES = (".jpg", ".jpeg", ".png", ".ppm", ".pgm")


def find_bundle(folder: Path) -> Path | None:
    """The result in a folder, or in one of its folders, as Bundler leaves it; none where there is
    no or more than one.
    """
    if (folder / BUNDLE).is_file():
        return folder / BUNDLE
    found = sorted(folder.glob(f"*/{BUNDLE}"))
    return found[0] if len(found) == 1 else None


def read_bundler(folder: Path, only: str | None = None) -> Reconstruction:
    """Reads a Bundler folder: `bundle.out` there or one folder below; the images by `list.txt`,
    else all that are there, in the order of their names.

    Args:
        folder: the folder.
        only: name of the one image to take, with or without its ending; all if not given.

    Raises:
        DataFolderError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    bundle = find_bundle(folder)
    if bundle is None:
        raise DataFolderError(f"{folder} has no {BUNDLE}, nor has one folder in it")
    numbers = _numbers(bundle)
    cameras, points, colours, tracks = _parsed(bundle, numbers)
    images = _images(folder, bundle.parent, len(cameras))
    seen_by = _seen_by(bundle, tracks, len(cameras))
    views = [
        _view(bundle, image, camera, *seen)
        for image, camera, seen in zip(images, cameras, seen_by, strict=True)
        if camera[0] > 0 and len(seen[0]) and only in (None, image.name, image.stem)
    ]
    if not views:
        which = "no camera" if only is None else f"no camera of an image '{only}'"
        raise DataFolderError(f"{bundle}: {which} is registered and sees a point")
    return Reconstruction(tuple(views), points, colours)


def _numbers(bundle: Path) -> Floats:
    try:
        lines = bundle.read_text().splitlines()
        if not lines or not lines[0].startswith(_MAGIC):
            raise DataFolderError(f"{bundle} does not begin with '{_MAGIC}'")
        return np.array(" ".join(lines[1:]).split(), np.float64)
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{bundle} cannot be read: {error}") from error


def _parsed(
    bundle: Path, numbers: Floats
) -> tuple[Floats, Floats, npt.NDArray[np.uint8], list[Floats]]:
    """(C, 15) cameras, (P, 3) points, (P, 3) colours, and of each point (V, 4) its views."""
    if len(numbers) < 2 or not (numbers[:2] >= 0).all():
        raise DataFolderError(f"{bundle} does not say how many cameras and points it holds")
    camera_count, point_count = int(numbers[0]), int(numbers[1])
    at = 2 + _CAMERA_NUMBERS * camera_count
    if len(numbers) < at:
        raise DataFolderError(f"{bundle} is cut off: it says {camera_count} cameras")
    cameras = numbers[2:at].reshape(-1, _CAMERA_NUMBERS)
    points, colours = np.zeros((point_count, 3)), np.zeros((point_count, 3), np.uint8)
    tracks = []
    for k in range(point_count):
        if at + _POINT_NUMBERS + 1 > len(numbers):
            raise DataFolderError(f"{bundle} is cut off: it says {point_count} points, has {k}")
        points[k] = numbers[at : at + 3]
        colours[k] = np.clip(numbers[at + 3 : at + 6], 0, 255)
        views = int(numbers[at + _POINT_NUMBERS])
        at += _POINT_NUMBERS + 1
        if views < 0 or at + 4 * views > len(numbers):
            raise DataFolderError(f"{bundle} is cut off in the views of point {k}")
        tracks.append(numbers[at : at + 4 * views].reshape(-1, 4))
        at += 4 * views
    if not (np.isfinite(cameras).all() and np.isfinite(points).all()):
        raise DataFolderError(f"{bundle} holds numbers that are not finite")
    return cameras, points, colours, tracks


def _seen_by(
    bundle: Path, tracks: list[Floats], camera_count: int
) -> list[tuple[npt.NDArray[np.int64], Floats]]:
    """Of each camera: (N,) which points it saw, and (N, 2) where, in Bundler's pixels."""
    numbers = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    all_views = np.concatenate(tracks) if tracks else np.zeros((0, 4))
    camera = all_views[:, 0].astype(np.int64)
    if len(camera) and not (camera.min() >= 0 and camera.max() < camera_count):
        raise DataFolderError(f"{bundle}: a point was seen by a camera that there is not")
    return [(numbers[camera == k], all_views[camera == k, 2:]) for k in range(camera_count)]


def _images(folder: Path, beside: Path, count: int) -> list[Path]:
    """The image of each camera."""
    for place in dict.fromkeys((folder, beside)):
        listed = place / LIST
        if listed.is_file():
            names = [line.split()[0] for line in listed.read_text().splitlines() if line.strip()]
            if len(names) != count:
                raise DataFolderError(f"{listed} names {len(names)} images for {count} cameras")
            return [_found(name, (place, folder)) for name in names]
    for place in dict.fromkeys((folder, beside)):
        found = sorted(one for one in place.iterdir() if one.suffix.lower() in _IMAGES)
        if len(found) == count:
            return found
    raise DataFolderError(
        f"{folder}: which image is which of the {count} cameras? There is no {LIST}, and not just "
        "as many images"
    )


def _found(name: str, places: tuple[Path, ...]) -> Path:
    """An image by the name in a list, which may be a path of the machine that it was made on."""
    tried = [Path(name), *(p / name for p in places), *(p / Path(name).name for p in places)]
    return next((path for path in tried if path.is_file()), places[-1] / Path(name).name)


def _view(
    bundle: Path, image: Path, camera: Floats, seen: npt.NDArray[np.int64], at: Floats
) -> ReconstructedView:
    f, k1, k2 = camera[:3].tolist()
    R, t = camera[3:12].reshape(3, 3), camera[12:]
    if abs(np.linalg.det(R) - 1.0) > 1e-3:
        raise DataFolderError(f"{bundle}: the camera of {image.name} has no rotation")
    width, height = image_size(image)
    K = np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]])
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _TURN @ R, _TURN @ t
    uv = undistorted(at * (1.0, -1.0) + K[:2, 2], K, (k1, k2))
    return ReconstructedView(image.name, image, width, height, K, (k1, k2), T, seen, uv)
