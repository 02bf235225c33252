"""Bundler's result (Snavely et al. 2006): `bundle.out` with the images, as its manual describes it.

Its cameras look down their negative z axis, y is up, and pixels count from the middle of the image:
p = -P / P.z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p. A camera of focal length 0 was not registered.
"""

from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.model import Floats, Indices, Reconstruction
from fleetpose.robot_agent.reconstructions.photos import Photo, reconstruction_of
from fleetpose.robot_agent.reconstructions.text import lines_of, numbers_of
from fleetpose.robot_agent.reconstructions.tracks import read_points

BUNDLE, LIST = "bundle.out", "list.txt"
_MAGIC = "# Bundle file"
_CAMERA_NUMBERS = 15
_TURN = np.diag([1.0, -1.0, -1.0])  # from Bundler's axes to OpenCV's
_IMAGES = (".jpg", ".jpeg", ".png", ".ppm", ".pgm")


def find_bundler(path: Path) -> list[Path]:
    """The results in a folder, else those one folder below, as Bundler leaves them; the path itself
    if it is a bundle file.
    """
    if path.suffix.lower() == ".out" and path.is_file():
        return [path]
    here = path / BUNDLE
    return [here] if here.is_file() else sorted(path.glob(f"*/{BUNDLE}"))


def read_bundler(bundle: Path, only: str | None = None) -> Reconstruction:
    """Reads a bundle file and finds its images, beside it or one folder above: by `list.txt`, else
    all that are there, in the order of their names.

    Args:
        bundle: the file.
        only: name of the one image to take, with or without its ending; all if not given.

    Raises:
        DataFolderError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    first, *lines = lines_of(bundle)
    if not first.startswith(_MAGIC):
        raise DataFolderError(f"{bundle} does not begin with '{_MAGIC}'")
    numbers = numbers_of(bundle, " ".join(lines))
    if len(numbers) < 2 or not (numbers[:2] >= 0).all():
        raise DataFolderError(f"{bundle} does not say how many cameras and points it holds")
    camera_count, point_count = int(numbers[0]), int(numbers[1])
    at = 2 + _CAMERA_NUMBERS * camera_count
    if len(numbers) < at:
        raise DataFolderError(f"{bundle} is cut off: it says {camera_count} cameras")
    cameras = numbers[2:at].reshape(-1, _CAMERA_NUMBERS)
    points, colours, seen = read_points(bundle, numbers[at:], point_count, camera_count)
    places = (bundle.parent, bundle.absolute().parent.parent)
    names = _names(bundle, places, camera_count)
    photos = [_photo(*one) for one in zip(names, cameras, seen, strict=True)]
    return reconstruction_of(bundle, photos, points, colours, places, only)


def _names(bundle: Path, places: tuple[Path, ...], count: int) -> list[str]:
    """The image of each camera."""
    for listed in (place / LIST for place in places):
        if listed.is_file():
            names = [line.split()[0] for line in lines_of(listed) if line]
            if len(names) != count:
                raise DataFolderError(f"{listed} names {len(names)} images for {count} cameras")
            return names
    for place in places:
        found = sorted(one.name for one in place.iterdir() if one.suffix.lower() in _IMAGES)
        if len(found) == count:
            return found
    raise DataFolderError(
        f"{bundle}: which image is which of the {count} cameras? There is no {LIST}, and not just "
        "as many images"
    )


def _photo(name: str, camera: Floats, seen: tuple[Indices, Floats]) -> Photo:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _TURN @ camera[3:12].reshape(3, 3), _TURN @ camera[12:]
    distortion = np.array([*camera[1:3], 0.0, 0.0])
    return Photo(name, camera[[0, 0]], distortion, T, seen[0], seen[1] * (1.0, -1.0))
