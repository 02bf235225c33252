"""How far a clicked point is off: pixels and metres, from the truth alone."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats, inverse, transform
from fleetpose.evaluation.system.tutor.truths import Truth
from fleetpose.protocol.messages import View

_HIDDEN_SHARE = 0.05  # of its depth: what stands so much nearer hides a point
_PATCH_PX, _SEARCH_PX = 15, 6  # half a patch that is compared, and how far it may slide
_WHOLE_STEPS = 0.2  # of a step: how near an offset is to whole steps of a pattern

Why = Literal["", "no pose", "no depth", "outside", "hidden"]


@dataclass(frozen=True)
class Offset:
    """How far off a point is.

    Attributes:
        fits: pixel of image j that shows what was clicked in image i; none where `why` tells.
        off_px: from there to what was clicked in image j.
        off_m: between what the two clicks show, in the world; none where one shows no surface.
        why: why there is no such pixel: poses or depth are not known, it is outside of the image
            or hidden there.
        alike: how alike the clicked place and the right one look, -1 to 1 (normalized
            cross-correlation of patches of 31 px); none where one is not within the image.
        px_m: what a pixel covers there, metres.
        steps: so many steps of a pattern that is known to repeat further; 0: not that.
    """

    fits: tuple[float, float] | None = None
    off_px: float | None = None
    off_m: float | None = None
    why: Why = ""
    alike: float | None = None
    px_m: float | None = None
    steps: int = 0


@dataclass(frozen=True)
class Clicked:
    """One side of a point: the view as it was recorded, its image, the pixel (2,)."""

    view: View
    jpeg: bytes | None
    pixel: Floats


def offset_of(truth: Truth, i: Clicked, j: Clicked) -> Offset:
    """How far a point is off, by what is true of both views."""
    T_world_i, T_world_j = _T_world_camera(truth, i.view), _T_world_camera(truth, j.view)
    if T_world_i is None or T_world_j is None or truth.gauge(i.view) != truth.gauge(j.view):
        return Offset(why="no pose")
    z_i, z_j = truth.depth_at(i.view, i.pixel), truth.depth_at(j.view, j.pixel)
    at_j = None if z_j is None else _lifted(j, z_j, T_world_j)
    if z_i is None:
        return Offset(why="no depth")
    at_i = _lifted(i, z_i, T_world_i)
    step = None if at_j is None else at_j - at_i
    off_m = None if step is None else float(np.linalg.norm(step))
    seen = transform(inverse(T_world_j), at_i[None])[0]
    camera = j.view.camera
    uv = (camera.K @ seen)[:2] / seen[2] if seen[2] > 0 else np.full(2, np.inf)
    if not (np.all(uv > -0.5) and np.all(uv < np.array((camera.width, camera.height)) - 0.5)):
        return Offset(off_m=off_m, why="outside")
    shown_m = truth.depth_at(j.view, uv)
    return Offset(
        (float(uv[0]), float(uv[1])),
        float(np.linalg.norm(uv - j.pixel)),
        off_m,
        "hidden" if shown_m is not None and shown_m < (1 - _HIDDEN_SHARE) * seen[2] else "",
        None if j.jpeg is None else likeness(_grey(j.jpeg), j.pixel, uv),
        float(seen[2] / camera.K[0, 0]),
        0 if step is None or truth.repeats_m is None else whole_steps(step, truth.repeats_m),
    )


def _T_world_camera(truth: Truth, view: View) -> Floats | None:
    T_world_robot = truth.T_world_robot(view)
    return None if T_world_robot is None else T_world_robot @ view.camera.T_robot_camera


def _lifted(clicked: Clicked, z_m: float, T_world_camera: Floats) -> Floats:
    """(3,) what a pixel shows, world."""
    ray = np.linalg.inv(clicked.view.camera.K) @ np.append(clicked.pixel, 1.0)
    return transform(T_world_camera, (z_m * ray)[None])[0]


def whole_steps(offset_m: Floats, step_m: Floats) -> int:
    """How many whole steps (3,) an offset (3,) is; 0 if it is none, or not whole ones."""
    length = float(np.linalg.norm(step_m))
    count = round(float(offset_m @ step_m) / length**2)
    rest_m = float(np.linalg.norm(offset_m - count * step_m))
    return count if rest_m < _WHOLE_STEPS * length else 0


def likeness(image: npt.NDArray[np.uint8], a: Floats, b: Floats) -> float | None:
    """How alike two places (2,) of a grey image look, -1 to 1, the second slid by a few pixels for
    the best; none where one is too near the edge.
    """
    first = _patch(image, a, _PATCH_PX)
    second = _patch(image, b, _PATCH_PX + _SEARCH_PX)
    if first is None or second is None:
        return None
    return float(cv2.matchTemplate(second, first, cv2.TM_CCOEFF_NORMED).max())


def _patch(image: npt.NDArray[np.uint8], centre: Floats, half: int) -> npt.NDArray[np.uint8] | None:
    u, v = (round(float(x)) for x in centre)
    height, width = image.shape
    if not (half <= u < width - half and half <= v < height - half):
        return None
    return image[v - half : v + half + 1, u - half : u + half + 1]


def _grey(jpeg: bytes) -> npt.NDArray[np.uint8]:
    decoded = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    return np.asarray(decoded, np.uint8)
