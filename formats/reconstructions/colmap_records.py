"""What COLMAP's files hold, whether text or binary."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from fleetpose.formats.arrays import Floats, FormatError, Indices

Track = Sequence[tuple[int, int]]
"""Of a point: the id of each image that saw it, and which of its keypoints that was."""

CAMERA_MODELS = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8),
}
"""Models that OpenCV has as well: how many focal lengths and distortion parameters each has; the
principal point stands between them."""


@dataclass(frozen=True, eq=False)
class ColmapCamera:
    """A camera: its model, width and height in px, and the model's parameters."""

    model: str
    size: tuple[int, int]
    parameters: Floats


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """An image, the id of its camera, and what it saw.

    Attributes:
        pose: (7,) rotation (w, x, y, z) and translation from the world to the camera.
        at: (N, 2) keypoints, px; (0.5, 0.5) is the middle of the first pixel.
        points: (N,) which point each is, by its id; -1 if none.
    """

    name: str
    camera: int
    pose: Floats
    at: Floats
    points: Indices


@dataclass(frozen=True, eq=False)
class ColmapPoints:
    """Points: ids (P,), where they are (P, 3), and their colours (P, 3), 0 to 255."""

    ids: Indices
    xyz: Floats
    colours: Floats


def check_model(path: Path, model: str) -> None:
    """Refuses a camera model that OpenCV does not have.

    Raises:
        FormatError: always then; it says what to do.
    """
    if model not in CAMERA_MODELS:
        raise FormatError(
            f"{path}: images of the camera model {model} cannot be undistorted here: run `colmap "
            f"image_undistorter` and give the folder that it writes"
        )
