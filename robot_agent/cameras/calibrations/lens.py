"""What the files of all tools come down to: two lenses, and how they stand to each other."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError

Floats = npt.NDArray[np.float64]
LensModel = Literal["normal", "fisheye"]
"""How the distortion's numbers are meant: k1 k2 p1 p2 ... of OpenCV's usual model ("radtan",
"plumb_bob", "rational_polynomial"), or k1 k2 k3 k4 of `cv2.fisheye` ("equidistant",
"KannalaBrandt8"). Those of one under the name of the other put depths off by a fifth."""

_FISHEYE = ("fisheye", "equi", "equidistant", "kannala", "kb4", "kb8")
FURTHEST_CENTRE = 0.18
"""Share of the image's side by which the optical axis may be off its middle where no file says the
size; half the size has 0.25, and crops of data sets have up to 0.1."""
MAX_SIZE = 65536  # px
_ALIKE = 0.1  # by which its place may differ across and down, of images of another size
_NORMAL = ("radtan", "plumb", "radial", "rational", "pinhole", "brown", "none", "normal")


@dataclass(frozen=True)
class Lens:
    """One camera: K (3, 3) px, D its distortion, and the model that D is of."""

    K: Floats
    D: Floats
    model: LensModel = "normal"


@dataclass(frozen=True)
class StereoPair:
    """What a file says of a rig.

    Attributes:
        left, right: the lenses.
        T_right_left: (4, 4) points of the left camera to the right one, in the file's unit.
        size: width, height of the images, px; None where the file does not say it.
        T_robot_left: (4, 4) metres, where the file says it.
    """

    left: Lens
    right: Lens
    T_right_left: Floats
    size: tuple[int, int] | None = None
    T_robot_left: Floats | None = None


def lens_model(name: Any, where: str) -> LensModel:
    """The model that a tool's name for it means.

    Raises:
        CalibrationError: it is neither of the two.
    """
    said = str(name).lower().replace("_", "").replace("-", "")
    if any(part in said for part in _FISHEYE):
        return "fisheye"
    if any(part in said for part in _NORMAL):
        return "normal"
    raise CalibrationError(
        f"{where}: the lens model '{name}' is not supported: calibrate with Kalibr's "
        "pinhole-radtan or pinhole-equi, or undistort the images before"
    )


def numbers(content: Mapping[str, Any], name: str, where: str, *counts: int) -> Floats:
    """The numbers under a name, flat, whichever way the file nests them.

    Raises:
        CalibrationError: there are none, or not as many as one of `counts`.
    """
    if content.get(name) is None:
        raise CalibrationError(f"{where} lacks {name}")
    found = flat(content[name], name, where)
    if found.size not in counts:
        wanted = " or ".join(map(str, counts))
        raise CalibrationError(f"{where}: {name} needs {wanted} numbers, it has {found.size}")
    return found


def size_of(
    content: Mapping[str, Any],
    where: str,
    width: str = "image_width",
    height: str = "image_height",
) -> tuple[int, int] | None:
    """Width and height under their names, px; None where a file has not both.

    Raises:
        CalibrationError: they are no size.
    """
    if content.get(width) is None or content.get(height) is None:
        return None
    w, h = (float(numbers(content, name, where, 1)[0]) for name in (width, height))
    if not (0 < w <= MAX_SIZE and 0 < h <= MAX_SIZE):
        raise CalibrationError(f"{where}: {width} {w:g} and {height} {h:g} are no size of images")
    return int(w), int(h)


def number(value: Any, name: str, where: str) -> float:
    """One number, whichever way the file nests it.

    Raises:
        CalibrationError: it is none, or several.
    """
    return float(numbers({name: value}, name, where, 1)[0])


def flat(value: Any, name: str, where: str) -> Floats:
    """A matrix as nested lists, as a map with `data`, or as a line of numbers.

    Raises:
        CalibrationError: it is none of them.
    """
    if isinstance(value, Mapping):
        value = value.get("data")
    if isinstance(value, str):
        value = value.replace(",", " ").split()
    try:
        found = np.array(value, np.float64).reshape(-1)
    except (TypeError, ValueError, OverflowError) as error:
        raise CalibrationError(f"{where}: {name} holds no numbers") from error
    if not np.isfinite(found).all():
        raise CalibrationError(f"{where}: {name} holds no numbers")
    return found


def pinhole(fx: float, fy: float, cx: float, cy: float) -> Floats:
    """K (3, 3), px."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def rigid(R: Floats, t: Floats) -> Floats:
    """(4, 4) of a rotation (3, 3) and a translation (3,)."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.reshape(3, 3), t.reshape(3)
    return T


def inverted(T: Floats) -> Floats:
    """The inverse of a (4, 4).

    Raises:
        CalibrationError: it has none, as a matrix of a pose has.
    """
    try:
        return np.asarray(np.linalg.inv(T), np.float64)
    except np.linalg.LinAlgError as error:
        raise CalibrationError(f"{np.round(T, 4).tolist()} is no pose of a camera") from error


def sideways(baseline: float) -> Floats:
    """(4, 4) of rectified images: the right camera stands so far to the right."""
    return rigid(np.eye(3), np.array([-baseline, 0.0, 0.0]))


def between_rectified(R_left: Floats, R_right: Floats, P_right: Floats) -> Floats:
    """T_right_left (4, 4) of two cameras that are given by what rectifies them: their rotations
    (3, 3), own axes to rectified ones, and the right one's projection (3, 4).
    """
    R = R_right.T @ R_left
    return rigid(R, R_right.T @ np.array([P_right[0, 3] / P_right[0, 0], 0.0, 0.0]))


def check_centre(K: Floats, size: tuple[int, int], where: str) -> None:
    """What a file that does not say its images' size may give away: its middle is not theirs.

    Raises:
        CalibrationError: the optical axis is as far from the middle across as down.
    """
    cx, cy = float(K[0, 2]), float(K[1, 2])
    across, down = cx / size[0], cy / size[1]
    off = max(abs(across - 0.5), abs(down - 0.5))
    if off > FURTHEST_CENTRE and min(cx, cy) > 0 and abs(across - down) < _ALIKE:
        raise CalibrationError(
            f"{where} has its optical axis at {cx:.0f}, {cy:.0f}, as images of about "
            f"{2 * cx + 1:.0f}x{2 * cy + 1:.0f} have, and these are {size[0]}x{size[1]}: scale fx, "
            "fy, cx and cy to their size, or write the size that it was made at into it (width, "
            "height) if that is theirs"
        )
