"""A picture of a cloud, for robots that have no image: an operator picks points in it, nothing is
matched by it.
"""

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.messages import Camera
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, Ranges

Floats = npt.NDArray[np.floating]

_SHADE = 0.6  # how much darker a surface is that is seen at a grazing angle


def picture_of(ranges: Ranges, model: Camera) -> npt.NDArray[np.uint8]:
    """(H, W, 3) BGR of the camera's size: near is red, far is blue, steep is dark, nothing is
    black.
    """
    depth = _depth_image(ranges, model)
    seen = np.isfinite(depth)
    if not seen.any():
        return np.zeros((model.height, model.width, 3), np.uint8)
    closeness = 1.0 / np.where(seen, depth, np.inf)
    low, high = np.percentile(closeness[seen], (2, 98))
    level = np.clip((closeness - low) / max(high - low, 1e-12), 0.0, 1.0)
    colours = cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_TURBO)
    picture = colours * _shading(np.where(seen, depth, 0.0), float(model.K[0, 0]))[..., None]
    picture[~seen] = 0
    return cv2.resize(
        picture.astype(np.uint8), (model.width, model.height), interpolation=cv2.INTER_NEAREST
    ).astype(np.uint8)


def _depth_image(ranges: Ranges, model: Camera) -> Floats:
    """(h, w) metres, nan where there is nothing; scattered points are as large as they must be to
    leave no holes between them.
    """
    if isinstance(ranges, DepthImage):
        depth = np.array(ranges.depth_m, np.float32)
        depth[~(depth > 0)] = np.nan
        return depth
    if isinstance(ranges, DisparityImage):
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.float32(ranges.focal_baseline_px_m) / ranges.disparity_px
        depth[~(ranges.disparity_px > 0)] = np.nan
        return depth
    nearest = np.full((model.height, model.width), np.inf, np.float32)
    u, v = np.rint(ranges.uv).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < model.width) & (v < model.height)
    np.minimum.at(nearest, (v[inside], u[inside]), ranges.z[inside].astype(np.float32))
    share = max(int(inside.sum()), 1) / nearest.size
    size = int(np.clip(np.ceil(share**-0.5), 1, 15))
    nearest = cv2.erode(nearest, np.ones((size, size), np.uint8), borderValue=float("inf"))
    return np.where(np.isfinite(nearest), nearest, np.nan)


def _shading(depth: Floats, focal_px: float) -> Floats:
    """1 where a surface faces the camera, less where it is steep."""
    down, across = np.gradient(depth.astype(np.float32))
    steepness = np.hypot(down, across) * focal_px
    return 1.0 - _SHADE * (1.0 - 1.0 / (1.0 + steepness / np.maximum(depth, 1e-6)))
