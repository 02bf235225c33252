"""Points as an image: the nearest in front, in the haze of distance; quicker than as many markers,
and small in a vector format too.
"""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.floating]

_COVERED = 0.5  # share of the image that dots may cover, were none behind another
_DOT_PX = (1, 4)  # radius, least and most


def dots(
    places: Floats,
    nearness: Floats,
    colours: Floats,
    box: Floats,
    shape: tuple[int, int],
    haze: float,
) -> npt.NDArray[np.uint8]:
    """An RGBA image (H, W, 4) of points, transparent between them, its first row at the bottom.

    Args:
        places: (N, 2) in the plane of the picture.
        nearness: (N,) towards who looks.
        colours: (N, 3) from 0 to 1.
        box: (2, 2) lower and upper corner of the image in the plane.
        shape: (H, W) pixels.
        haze: how far the farthest fade, share of white.
    """
    height, width = shape
    image = np.zeros((height * width, 4), np.uint8)
    at = np.floor((places - box[0]) / (box[1] - box[0]) * (width, height)).astype(np.int64)
    order = np.argsort(nearness)
    order = order[((at >= 0) & (at < (width, height))).all(axis=1)[order]]
    if not len(order):
        return image.reshape(height, width, 4)
    disc = _disc(float((_COVERED * height * width / (np.pi * len(order))) ** 0.5))
    u, v = (at[order, k, None] + disc[:, k] for k in (0, 1))
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows, _ = np.nonzero(inside)
    # of pixels that are named again the last value stays: the nearest point
    image[(v * width + u)[inside]] = _hazy(nearness[order], colours[order], haze)[rows]
    return image.reshape(height, width, 4)


def _disc(radius_px: float) -> npt.NDArray[np.int64]:
    """(K, 2) pixels of a dot."""
    reach = int(np.clip(round(radius_px), *_DOT_PX))
    grid = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), axis=-1).reshape(-1, 2)
    return grid[(grid**2).sum(axis=1) <= reach**2]


def _hazy(nearness: Floats, colours: Floats, haze: float) -> npt.NDArray[np.uint8]:
    """Colours (N, 4), nearest last; far ones paler."""
    low, high = np.percentile(nearness, (2, 98))
    share = haze * np.clip((high - nearness) / max(high - low, 1e-9), 0.0, 1.0)[:, None]
    mixed = np.hstack((colours * (1.0 - share) + share, np.ones((len(colours), 1))))
    return np.rint(255.0 * mixed).astype(np.uint8)
