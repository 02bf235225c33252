"""Finding the pixel that is meant: corners to snap to, places worth a pick, and where a point of
one image is to be expected in the other. Arrays in, pixels out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.records import PixelUV

Image = npt.NDArray[np.uint8]
Floats = npt.NDArray[np.floating]

SNAP_PX = 6
_PATCHES = ((8.0, 1), (14.0, 2))  # px and octave: what a point looks like, close and wider around
_SIMILAR = 0.85  # mean cosine of the looks of two points that may be one; see `alike`
_FARNESS = 0.0005  # of a cosine for each pixel that a place is farther from where it is expected
_FIRST_LAYER = 1 << 8  # how OpenCV packs a layer beside an octave
_CORNERS, _CORNERS_APART_PX = 800, 4.0


def snap_to_corner(grey: Image, pixel: PixelUV, reach_px: int = SNAP_PX) -> PixelUV | None:
    """The corner nearest in looks to what a hand meant: the strongest one (Shi and Tomasi) within
    reach, to a fraction of a pixel; none where nothing is like a corner.

    Args:
        grey: (H, W) image.
        pixel: where the cursor is.
        reach_px: how far the corner may be.
    """
    height, width = grey.shape
    margin = reach_px + 4
    u, v = round(pixel[0]), round(pixel[1])
    left, top = max(u - margin, 0), max(v - margin, 0)
    patch = np.ascontiguousarray(grey[top : v + margin + 1, left : u + margin + 1])
    if min(patch.shape) < 7:
        return None
    strength = cv2.cornerMinEigenVal(patch, 3)
    rows, columns = np.indices(patch.shape)
    far = np.hypot(columns + left - pixel[0], rows + top - pixel[1]) > reach_px
    strength[far] = 0.0
    row, column = np.unravel_index(int(np.argmax(strength)), strength.shape)
    if strength[row, column] < 1e-4:
        return None
    start = np.array([[[column + left, row + top]]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 20, 0.01)
    if not (5 <= start[0, 0, 0] < width - 5 and 5 <= start[0, 0, 1] < height - 5):
        return float(start[0, 0, 0]), float(start[0, 0, 1])
    found = cv2.cornerSubPix(grey, start.copy(), (3, 3), (-1, -1), criteria)[0, 0]
    if np.linalg.norm(found - start[0, 0]) > 3:  # it ran away: the whole pixel is safer
        found = start[0, 0]
    return float(found[0]), float(found[1])


def corners(grey: Image, apart_px: float, at_most: int = 400) -> Floats:
    """(N, 2) pixels of the strongest corners, the strongest first, that far apart."""
    found = cv2.goodFeaturesToTrack(grey, at_most, 0.01, apart_px)
    return np.zeros((0, 2)) if found is None else found[:, 0].astype(np.float64)


def by_strength(grey: Image, uv: Floats) -> npt.NDArray[np.int64]:
    """(N,) order of some pixels (N, 2) by how much of a corner they are, the strongest first."""
    strength = cv2.cornerMinEigenVal(grey, 5)
    columns, rows = np.rint(uv).astype(int).T if len(uv) else np.zeros((2, 0), int)
    height, width = grey.shape
    inside = strength[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    return np.argsort(-inside, kind="stable")


def by_likeness(
    grey: Image, uv: Floats, look: npt.NDArray[np.float32], near: PixelUV | None
) -> npt.NDArray[np.int64]:
    """(N,) order of some pixels (N, 2) by how much they look like a look (A, 128), the most first;
    of those that look about as good the nearest to where it is expected.
    """
    return np.argsort(-_near(_cosines(_look(grey, uv), look), uv, near), kind="stable")


def apart(uv: Floats, least_u: float, least_v: float, at_most: int) -> list[int]:
    """The first of some pixels (N, 2) that are so far from all chosen before them."""
    chosen: list[int] = []
    for k, (u, v) in enumerate(uv.tolist()):
        if all(abs(u - uv[c, 0]) >= least_u or abs(v - uv[c, 1]) >= least_v for c in chosen):
            chosen.append(k)
        if len(chosen) == at_most:
            break
    return chosen


@dataclass(frozen=True)
class Looks:
    """What the corners of an image look like.

    Attributes:
        uv: (N, 2) pixels.
        descriptors: (N, A, 128) at a few scales, each of unit length (RootSIFT).
    """

    uv: Floats
    descriptors: npt.NDArray[np.float32]


def looks_of(grey: Image) -> Looks:
    """The corners of an image, as `look_at` sees a pixel; 40 ms for 640x480 on one core."""
    uv = corners(grey, _CORNERS_APART_PX, _CORNERS)
    return Looks(uv, _look(grey, uv))


def look_at(grey: Image, pixel: PixelUV) -> npt.NDArray[np.float32]:
    """(A, 128) what a pixel looks like, at a few scales, upright: cameras seldom roll."""
    return _look(grey, np.array([pixel]))[0]


def _look(grey: Image, uv: Floats) -> npt.NDArray[np.float32]:
    """(N, A, 128); each scale in its own octave, as SIFT samples what it finds itself: in the full
    image the wide patch alone takes three times as long as both.
    """
    points = [
        cv2.KeyPoint(u, v, size, 0.0, 0.0, octave | _FIRST_LAYER)
        for u, v in uv.tolist()
        for size, octave in _PATCHES
    ]
    if not points:
        return np.zeros((0, len(_PATCHES), 128), np.float32)
    _, descriptors = cv2.SIFT.create().compute(grey, points)
    return _rooted(descriptors).reshape(len(uv), len(_PATCHES), 128)


def alike(look: npt.NDArray[np.float32], looks: Looks, near: PixelUV | None = None) -> int | None:
    """Which of an image's points looks most like another image's pixel; none if none does.

    It has to look alike at all scales: fronts of buildings repeat what they show close by.

    Args:
        look: (A, 128) of the pixel.
        looks: of the other image.
        near: where it is expected; of points that look about as good the nearest is taken.
    """
    if not len(looks.uv):
        return None
    cosine = _near(_cosines(looks.descriptors, look), looks.uv, near)
    best = int(np.argmax(cosine))
    return best if cosine[best] >= _SIMILAR else None


def _cosines(descriptors: npt.NDArray[np.float32], look: npt.NDArray[np.float32]) -> Floats:
    """(N,) how alike looks (N, A, 128) and a look (A, 128) are: the mean over their scales."""
    return np.einsum("nak,ak->n", descriptors, look) / len(look)


def _near(cosine: Floats, uv: Floats, near: PixelUV | None) -> Floats:
    """(N,) cosines, less for pixels (N, 2) that are farther from where one is expected."""
    return cosine if near is None else cosine - _FARNESS * np.linalg.norm(uv - near, axis=1)


def mapped(pixel: PixelUV, source: Sequence[PixelUV], target: Sequence[PixelUV]) -> PixelUV | None:
    """Where a pixel goes with the points clicked so far: moved with one, turned and scaled with
    two, affine with three and more. A scene is not flat: this is a place to look at, no answer.

    Args:
        pixel: in the source image.
        source, target: the clicked pixels, in the same order.
    """
    if not source:
        return None
    a, b = np.asarray(source, np.float64), np.asarray(target, np.float64)
    if len(a) == 1:
        moved = np.asarray(pixel) + b[0] - a[0]
        return float(moved[0]), float(moved[1])
    if len(a) == 2:
        step_a, step_b = complex(*(a[1] - a[0])), complex(*(b[1] - b[0]))
        if abs(step_a) < 1.0:
            return mapped(pixel, source[:1], target[:1])
        there = complex(*b[0]) + (complex(*pixel) - complex(*a[0])) * step_b / step_a
        return there.real, there.imag
    design = np.column_stack((a, np.ones(len(a))))
    solution, _, rank, _ = np.linalg.lstsq(design, b, rcond=1e-3)
    if rank < 3:
        return mapped(pixel, source[:2], target[:2])
    there = np.array((*pixel, 1.0)) @ solution
    return float(there[0]), float(there[1])


def projected(point: Floats, K: Floats) -> PixelUV | None:
    """The pixel of a point (3,) in the camera frame; none behind the camera."""
    if point[2] <= 1e-6:
        return None
    u, v, w = K @ point
    return float(u / w), float(v / w)


def _rooted(descriptors: npt.ArrayLike) -> npt.NDArray[np.float32]:
    whole = np.asarray(descriptors, np.float32)
    total = np.maximum(np.abs(whole).sum(axis=1, keepdims=True), 1e-6)
    return np.sqrt(whole / total)
