"""Bundler's result (Snavely et al. 2006): `bundle.out` with the images, as its manual describes it.

Its cameras look down their negative z axis, y is up, and pixels count from the middle of the image:
p = -P / P.z, p' = f (1 + k1 |p|^2 + k2 |p|^4) p. A camera of focal length 0 was not registered.
"""

from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.reconstructions.photos import MOST_NAMED, Model, Photo, single_words
from fleetpose.formats.reconstructions.tracks import point_lines, read_points
from fleetpose.formats.text import joined, lines_of, numbers_of, shortest

LIST = "list.txt"
_MAGIC = "# Bundle file"
_CAMERA_NUMBERS = 15
_TURN = np.diag([1.0, -1.0, -1.0])  # from Bundler's axes to OpenCV's
_IMAGES = (".jpg", ".jpeg", ".png", ".ppm", ".pgm")


def image_folders(bundle: Path) -> tuple[Path, ...]:
    """Where the images of a bundle file may lie: beside it, or one folder above."""
    return bundle.parent, bundle.absolute().parent.parent


def read_bundler(bundle: Path) -> Model:
    """Reads a bundle file; its images are called as `list.txt` says, else as those that are there,
    in the order of their names.

    Raises:
        FormatError: a file is missing, cut off, or says what cannot be; the text names it.
    """
    first, *lines = lines_of(bundle)
    if not first.startswith(_MAGIC):
        raise FormatError(f"{bundle} does not begin with '{_MAGIC}'")
    numbers = numbers_of(bundle, " ".join(lines))
    if len(numbers) < 2 or not (numbers[:2] >= 0).all():
        raise FormatError(f"{bundle} does not say how many cameras and points it holds")
    camera_count, point_count = int(numbers[0]), int(numbers[1])
    at = 2 + _CAMERA_NUMBERS * camera_count
    if len(numbers) < at:
        raise FormatError(f"{bundle} is cut off: it says {camera_count} cameras")
    cameras = numbers[2:at].reshape(-1, _CAMERA_NUMBERS)
    points, colours, seen = read_points(bundle, numbers[at:], point_count, camera_count)
    names = _names(bundle, image_folders(bundle), camera_count)
    photos = [_photo(*one) for one in zip(names, cameras, seen, strict=True)]
    return Model(tuple(photos), points, colours)


def write_bundler(bundle: Path, model: Model) -> None:
    """Writes a bundle file, and `list.txt` beside it.

    The format knows no principal point: features count from where it is, and an image whose
    principal point is not its middle is to be cut so that it is.

    Raises:
        FormatError: a camera or a name has no place in this format; the text names it.
        OSError: it cannot be written.
    """
    single_words([photo.name for photo in model.photos])
    lines = [f"{_MAGIC} v0.3", f"{len(model.photos)} {len(model.points)}"]
    for photo in model.photos:
        T = photo.T_camera_world
        k1, k2 = _radial(photo)
        lines.append(f"{shortest(photo.square_focal_px)} {shortest(k1)} {shortest(k2)}")
        lines += [joined(row) for row in _TURN @ T[:3, :3]]
        lines.append(joined(_TURN @ T[:3, 3]))
    at = [photo.square_at * (1.0, -1.0) for photo in model.photos]
    for words in point_lines(model, at):
        lines += [" ".join(words[:3]), " ".join(words[3:6]), " ".join(words[6:])]
    bundle.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    listed = "".join(f"{photo.name}\n" for photo in model.photos)
    (bundle.parent / LIST).write_text(listed, encoding="utf-8")


def _radial(photo: Photo) -> Floats:
    """k1 and k2 of a photo that has no other distortion."""
    if photo.distortion[2:].any():
        raise FormatError(
            f"{photo.name[:MOST_NAMED]} has distortion that Bundler does not know: undistort it"
        )
    return photo.distortion[:2]


def _names(bundle: Path, places: tuple[Path, ...], count: int) -> list[str]:
    """The image of each camera."""
    for listed in (place / LIST for place in places):
        if listed.is_file():
            names = [line.split()[0] for line in lines_of(listed) if line]
            if len(names) != count:
                raise FormatError(f"{listed} names {len(names)} images for {count} cameras")
            return names
    for place in places:
        found = sorted(one.name for one in place.iterdir() if one.suffix.lower() in _IMAGES)
        if len(found) == count:
            return found
    raise FormatError(
        f"{bundle}: which image is which of the {count} cameras? There is no {LIST}, and not just "
        "as many images"
    )


def _photo(name: str, camera: Floats, seen: tuple[Indices, Floats]) -> Photo:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = _TURN @ camera[3:12].reshape(3, 3), _TURN @ camera[12:]
    distortion = np.array([*camera[1:3], 0.0, 0.0])
    return Photo(name, camera[[0, 0]], distortion, T, seen[0], seen[1] * (1.0, -1.0))
