"""Photos and points as the files of all kinds tell of them."""

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices

SQUARE_WITHIN = 1e-3  # relative difference of fx and fy
MOST_NAMED = 80  # characters of a name in an error


@dataclass(frozen=True, eq=False)
class Photo:
    """One photo as a file tells of it; its camera has OpenCV axes.

    Attributes:
        name: what the file calls its image, which may be a path.
        focal_px: (2,) along x and y; a photo that was not registered has none above 0.
        distortion: OpenCV's vector (4,) or (8,).
        T_camera_world: (4, 4).
        seen: (N,) which points it saw.
        at: (N, 2) where, px of the image as it is, from the principal point, y down.
        centre: (2,) the principal point, px, (0, 0) the middle of the first pixel; the middle of
            the image if none.
        size: width and height, px, if the file tells them.
    """

    name: str
    focal_px: Floats
    distortion: Floats
    T_camera_world: Floats
    seen: Indices
    at: Floats
    centre: Floats | None = None
    size: tuple[int, int] | None = None

    @property
    def bare_name(self) -> str:
        """Without folders; the file may come from another machine, of another system."""
        return PureWindowsPath(self.name).name

    def is_called(self, name: str | None) -> bool:
        """Whether it goes by that name, with or without folders and ending; all do by none."""
        return name in (None, self.name, self.bare_name, Path(self.bare_name).stem)

    @property
    def square_focal_px(self) -> float:
        """Its one focal length.

        Raises:
            FormatError: its pixels are not square.
        """
        fx, fy = self.focal_px
        if abs(fx - fy) > SQUARE_WITHIN * abs(fx):
            raise FormatError(
                f"{self.name[:MOST_NAMED]}: pixels that are not square (fx {fx:g}, fy {fy:g}) have "
                "no place in this format: write COLMAP's"
            )
        return float(np.sqrt(fx * fy))

    @property
    def square_at(self) -> Floats:
        """(N, 2) where it saw its points, in square pixels of that focal length."""
        return self.at * (self.square_focal_px / self.focal_px)


@dataclass(frozen=True, eq=False)
class Model:
    """Photos, and points (P, 3) of the world with their colours (P, 3), 0 to 255."""

    photos: tuple[Photo, ...]
    points: Floats
    colours: Floats


def all_finite(model: Model) -> bool:
    """Whether all numbers of a model are."""
    return bool(np.isfinite(model.points).all() and all(_is_finite(p) for p in model.photos))


def _is_finite(photo: Photo) -> bool:
    centre = np.zeros(2) if photo.centre is None else photo.centre
    numbers = (photo.focal_px, photo.distortion, photo.T_camera_world, photo.at, centre)
    return all(np.isfinite(one).all() for one in numbers)


def single_words(names: list[str]) -> None:
    """Refuses names that a format of words and blanks cannot hold.

    Raises:
        FormatError: one of them is empty or has a blank.
    """
    for name in names:
        if len(name.split()) != 1 or name != name.strip():
            raise FormatError(f"image {name[:MOST_NAMED]!r}: give it a name without blanks")
