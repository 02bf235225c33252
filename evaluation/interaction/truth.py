"""What the simulated operator knows of recorded views: which pixels show the same point."""

import numpy as np

from evaluation.datasets import Recording, TrueView, points_of
from evaluation.geometry import Floats, inverse
from evaluation.operator import by_depth, by_tracks

_TRIED_POINTS = 4000


def true_pixels(recording: Recording, i: TrueView, j: TrueView) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of view i and of view j that show the same N points: the common tracks, or
    where there are none the depths at the true pose.
    """
    tracks_i, tracks_j = recording.tracks(i), recording.tracks(j)
    if tracks_i is not None and tracks_j is not None:
        return by_tracks(*tracks_i, *tracks_j)
    uv_i, points_i = points_of(i)
    uv_j, points_j = points_of(j)
    some = slice(None, None, max(len(uv_i) // _TRIED_POINTS, 1))
    T_j_i = inverse(j.T_world_camera) @ i.T_world_camera
    pixels_i, pixels_j = by_depth(points_i[some], uv_i[some], points_j, uv_j, j.K, T_j_i)
    inside = ((pixels_j >= 0) & (pixels_j <= np.array((j.width - 1, j.height - 1)))).all(axis=1)
    return pixels_i[inside], pixels_j[inside]
