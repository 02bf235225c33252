"""Two views of a pair side by side, with what the truth says that both see."""

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.data.opening import points_of
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats, inverse, transform
from fleetpose.evaluation.simulate.operator import by_tracks

Image = npt.NDArray[np.uint8]

WIDTH_PX = 460  # of one view
JPEG_QUALITY = 72
POINTS, TRACKS = 500, 25
POINT_COLOUR = (255, 220, 0)  # blue, green, red


def side_by_side(recording: Recording, i: TrueView, j: TrueView) -> bytes:
    """A JPEG: view i at the left, view j at the right.

    Dots are points of the other view's cloud at the true pose. Rings of one colour are one track.
    A dot tells what lies in view, not what is seen: something may stand before it.
    """
    T_i_j = i.T_to(j)
    pictures = [_with_points(i, j, T_i_j), _with_points(j, i, inverse(T_i_j))]
    tracks_i, tracks_j = recording.tracks(i), recording.tracks(j)
    if tracks_i is not None and tracks_j is not None:
        uv_i, uv_j = by_tracks(*tracks_i, *tracks_j)
        chosen = np.linspace(0, len(uv_i) - 1, min(TRACKS, len(uv_i))).astype(int)
        hues = np.linspace(0, 179, len(chosen), endpoint=False)
        for picture, view, uv in zip(pictures, (i, j), (uv_i, uv_j), strict=True):
            for pixel, hue in zip(_shown(view, uv[chosen]), hues, strict=True):
                cv2.circle(picture, pixel, 6, _colour(hue), 2, cv2.LINE_AA)
    height = max(len(picture) for picture in pictures)
    both = np.hstack(
        [
            cv2.copyMakeBorder(p, 0, height - len(p), 0, 4, cv2.BORDER_CONSTANT, value=(255,) * 3)
            for p in pictures
        ]
    )
    return cv2.imencode(".jpg", both, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()


def _with_points(view: TrueView, other: TrueView, T_view_other: Floats) -> Image:
    """A view, made small, with points of another one."""
    image = cv2.imread(str(view.image), cv2.IMREAD_COLOR)
    if image is None:  # the report goes on without: the picture is no result
        image = np.full((view.height, view.width, 3), 128, np.uint8)
    height = round(WIDTH_PX * view.height / view.width)
    small = np.asarray(
        cv2.resize(image, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8
    )
    points = points_of(other)[1]
    points = points[:: max(len(points) // POINTS, 1)]
    moved = transform(T_view_other, points)
    moved = moved[moved[:, 2] > 0]
    uv = (moved @ view.K.T)[:, :2] / moved[:, 2:]
    inside = ((uv >= 0) & (uv < (view.width, view.height))).all(axis=1)
    for pixel in _shown(view, uv[inside]):
        cv2.circle(small, pixel, 2, POINT_COLOUR, -1, cv2.LINE_AA)
    return small


def _shown(view: TrueView, uv: Floats) -> list[tuple[int, int]]:
    """Pixels (N, 2) of a view where they are in its small image."""
    return [(int(u), int(v)) for u, v in uv * (WIDTH_PX / view.width)]


def _colour(hue: float) -> tuple[int, int, int]:
    pixel = np.array([[[hue, 255, 255]]], np.uint8)
    blue, green, red = cv2.cvtColor(pixel, cv2.COLOR_HSV2BGR)[0, 0].tolist()
    return blue, green, red
