"""Photos as the files of all kinds tell of them, made into views."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from fleetpose.formats.reconstructions.photos import Model, Photo, all_finite
from fleetpose.formats.rotations import is_rotation
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.model import Floats, ReconstructedView, Reconstruction

_MOST_STEPS, _UNDISTORTED_TO = 50, 1e-10  # of OpenCV's iteration; of the focal length


def reconstruction_of(
    source: Path, model: Model, places: Sequence[Path], only: str | None
) -> Reconstruction:
    """What a file tells, as views whose images are there.

    Args:
        source: the file.
        model: what it says.
        places: folders that images may lie in, the likeliest first.
        only: name of the one image to take; all if not given.

    Raises:
        DataFolderError: no photo is registered, an image is missing or of another size, or numbers
            are not what they should be; the text names it.
    """
    if not all_finite(model):
        raise DataFolderError(f"{source} holds numbers that are not finite")
    chosen = [
        photo
        for photo in model.photos
        if (photo.focal_px > 0).all() and len(photo.seen) and photo.is_called(only)
    ]
    if not chosen:
        which = "no photo" if only is None else f"no photo '{only}'"
        raise DataFolderError(f"{source}: {which} is registered and sees a point")
    views = tuple(_view(source, photo, places) for photo in chosen)
    if len({view.image for view in views}) < len(views):
        raise DataFolderError(f"{source}: several of its photos have the same image file")
    return Reconstruction(views, model.points, np.clip(model.colours, 0, 255).astype(np.uint8))


def _view(source: Path, photo: Photo, places: Sequence[Path]) -> ReconstructedView:
    if not is_rotation(photo.T_camera_world[:3, :3]):
        raise DataFolderError(f"{source}: the camera of {photo.name} has no rotation")
    name, image = _found(source, photo, places)
    width, height = image_size(image)
    if photo.size not in (None, (width, height)):
        raise DataFolderError(
            f"{image} has {(width, height)} pixels, {source} says {photo.size}: give the images "
            "that it was made of"
        )
    K = np.diag([*photo.focal_px, 1.0])
    K[:2, 2] = (0.5 * (width - 1), 0.5 * (height - 1)) if photo.centre is None else photo.centre
    uv = _undistorted(photo.at + K[:2, 2], K, photo.distortion)
    return ReconstructedView(
        name, image, width, height, K, photo.distortion, photo.T_camera_world, photo.seen, uv
    )


def _found(source: Path, photo: Photo, places: Sequence[Path]) -> tuple[str, Path]:
    """The image and its name below its folder; the file may tell a path of another machine."""
    absolute = Path(photo.name).is_absolute()
    for name in (photo.name, photo.bare_name):
        for place in places:
            if _is_file(place / name):
                return photo.bare_name if absolute else Path(name).as_posix(), place / name
    where = " or ".join(map(str, places))
    raise DataFolderError(f"{source}: there is no image {photo.name} in {where}")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # no name that a file can have
        return False


def image_size(path: Path) -> tuple[int, int]:
    """Width and height of an image file.

    Raises:
        DataFolderError: it is no image.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    if picture is None:
        raise DataFolderError(f"{path} is no image")
    height, width = picture.shape
    return width, height


def _undistorted(uv: Floats, K: Floats, distortion: Floats) -> Floats:
    """Pixels (N, 2) of a distorted image as pixels of the undistorted one with the same K."""
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, _MOST_STEPS, _UNDISTORTED_TO)
    turned = cv2.undistortPoints(
        np.ascontiguousarray(uv[:, None], np.float64), K, distortion, P=K, criteria=until
    )
    return np.asarray(turned, np.float64).reshape(-1, 2)
