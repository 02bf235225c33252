"""Points with the photos that saw each, as Bundler and VisualSfM write them: x y z, r g b, the
number of views, and of each view its photo, its feature and its pixel.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.model import Floats, Indices

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
        DataFolderError: there are fewer points, or one was seen in a photo that there is not.
    """
    heads, tracks, at = [], [], 0
    for k in range(count):
        head = numbers[at : at + _POINT]
        if len(head) < _POINT:
            raise DataFolderError(f"{source} is cut off: it says {count} points, has {k}")
        at += _POINT
        views = int(head[-1])
        if views < 0 or at + _VIEW * views > len(numbers):
            raise DataFolderError(f"{source} is cut off in the views of point {k}")
        heads.append(head)
        tracks.append(numbers[at : at + _VIEW * views].reshape(-1, _VIEW))
        at += _VIEW * views
    all_heads = np.array(heads).reshape(-1, _POINT)
    return all_heads[:, :3], all_heads[:, 3:6], _by_photo(source, tracks, photos)


def _by_photo(source: Path, tracks: Sequence[Floats], photos: int) -> list[tuple[Indices, Floats]]:
    points = np.repeat(np.arange(len(tracks)), [len(track) for track in tracks])
    views = np.concatenate([np.zeros((0, _VIEW)), *tracks])
    if not ((views[:, 0] >= 0) & (views[:, 0] < photos)).all():
        raise DataFolderError(f"{source}: a point was seen by a camera that there is not")
    order = np.argsort(views[:, 0], kind="stable")
    cuts = np.searchsorted(views[order, 0], np.arange(1, photos))
    parts = zip(np.split(points[order], cuts), np.split(views[order, 2:], cuts), strict=True)
    return list(parts)[:photos]
