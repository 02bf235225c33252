"""Points with the photos that saw each, as Bundler and VisualSfM write them: x y z, r g b, the
number of views, and of each view its photo, its feature and its pixel.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.formats.arrays import Floats, FormatError, Indices
from fleetpose.formats.reconstructions.photos import Model
from fleetpose.formats.text import shortest

_POINT, _VIEW = 7, 4  # numbers of each


def read_points(
    source: Path, numbers: Floats, count: int, photos: int
) -> tuple[Floats, Floats, list[tuple[Indices, Floats]]]:
    """Reads points that follow each other.

    Args:
        source: the file, for errors.
        numbers: (N,) from the first point on.
        count: of points.
        photos: how many there are.

    Returns:
        (P, 3) points, (P, 3) colours, and of each photo (N,) which points it saw and (N, 2) where.

    Raises:
        FormatError: there are fewer points, or one was seen in a photo that there is not.
    """
    heads, tracks, at = [], [], 0
    for k in range(count):
        head = numbers[at : at + _POINT]
        if len(head) < _POINT:
            raise FormatError(f"{source} is cut off: it says {count} points, has {k}")
        at += _POINT
        views = int(head[-1])
        if views < 0 or at + _VIEW * views > len(numbers):
            raise FormatError(f"{source} is cut off in the views of point {k}")
        heads.append(head)
        tracks.append(numbers[at : at + _VIEW * views].reshape(-1, _VIEW))
        at += _VIEW * views
    all_heads = np.array(heads).reshape(-1, _POINT)
    return all_heads[:, :3], all_heads[:, 3:6], _by_photo(source, tracks, photos)


def _by_photo(source: Path, tracks: Sequence[Floats], photos: int) -> list[tuple[Indices, Floats]]:
    points = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    views = np.concatenate([np.zeros((0, _VIEW)), *tracks])
    if not ((views[:, 0] >= 0) & (views[:, 0] < photos)).all():
        raise FormatError(f"{source}: a point was seen by a camera that there is not")
    order = np.argsort(views[:, 0], kind="stable")
    cuts = np.searchsorted(views[order, 0], np.arange(1, photos))
    parts = zip(np.split(points[order], cuts), np.split(views[order, 2:], cuts), strict=True)
    return list(parts)[:photos]


def point_lines(model: Model, at: Sequence[Floats]) -> list[list[str]]:
    """The points of a model as words: place, colour, then the count of views and the views.

    Args:
        model: of which each photo's features count in the order of its `seen`.
        at: of each photo (N, 2), the pixels as the format has them.
    """
    tracks: list[list[str]] = [[] for _ in model.points]
    for k, (photo, uv) in enumerate(zip(model.photos, at, strict=True)):
        for feature, (point, (u, v)) in enumerate(zip(photo.seen.tolist(), uv, strict=True)):
            tracks[point] += [str(k), str(feature), shortest(u), shortest(v)]
    colours = np.clip(np.rint(model.colours), 0, 255).astype(int)
    rows = zip(model.points, colours, tracks, strict=True)
    return [
        [*map(shortest, p), *map(str, c), str(len(track) // _VIEW), *track] for p, c, track in rows
    ]
