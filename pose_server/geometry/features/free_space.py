"""Does the world agree with a pose? The moved cloud must lie on what the other view sees, and hide
nothing it sees.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.features.patches import Patches, patches_of
from fleetpose.pose_server.geometry.se3 import inverse, transform

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class Surface:
    """What a view sees, as pixels with depths.

    Attributes:
        K: (3, 3) intrinsics, px.
        size: (width, height), px.
        uv: (N, 2) pixels of all points.
        z: (N,) their depths, metres.
        sample: (S, 3) some of the points in the camera frame.
        depth_sigma: relative sigma of a depth, sigma(z) / z, at the median depth.
    """

    K: Floats
    size: tuple[int, int]
    uv: Floats
    z: Floats
    sample: Floats
    depth_sigma: float

    @cached_property
    def tree(self) -> cKDTree:
        """Of the pixels."""
        return cKDTree(self.uv)

    @cached_property
    def patches(self) -> Patches:
        """Planes through the points."""
        return patches_of(self.uv, self.z, self.K, self.depth_sigma)

    @cached_property
    def spacing_px(self) -> float:
        """Median distance from a sampled pixel to its nearest neighbour."""
        step = max(1, len(self.uv) // 500)
        return (
            float(np.median(self.tree.query(self.uv[::step], k=2)[0][:, 1]))
            if len(self.uv) > 1
            else 1.0
        )


@dataclass(frozen=True)
class SeenAgain:
    """How one view's points look in the other.

    Attributes:
        visible: share of the sample that falls into the image.
        compared: number of points near a point of the other view.
        agree: share of these whose depth agrees with one of the nearest.
        through: share that lies clearly in front of all the nearest: the other view sees through
            them.
    """

    visible: float
    compared: int
    agree: float
    through: float


@dataclass(frozen=True)
class Agreement:
    """Both directions together: `agree` and `through` are the worse ones, `overlap` the mean."""

    compared: int
    agree: float
    mean_agree: float
    through: float
    overlap: float


def hides(surface: Surface, uv: Floats, z: Floats, sigma: float) -> npt.NDArray[np.bool_]:
    """Which points at pixels (N, 2) with depths (N,) are hidden: all that the surface has around
    there is clearly nearer. `sigma` is the relative one of the difference of both depths.
    """
    if len(uv) == 0:
        return np.zeros(0, bool)
    distance, near = surface.tree.query(
        uv, k=min(4, surface.tree.n), distance_upper_bound=_radius_px(surface)
    )
    found = np.isfinite(distance.reshape(len(uv), -1))
    depths = np.where(found, surface.z[np.where(found, near.reshape(len(uv), -1), 0)], -np.inf)
    farthest = depths.max(axis=1)
    return np.isfinite(farthest) & (farthest < z * (1 - max(0.03, 4.0 * sigma)))


def _radius_px(surface: Surface) -> float:
    """How near a pixel must be to tell of a surface there."""
    return float(np.clip(3 * surface.spacing_px, 4.0, 8.0))


def agreement(i: Surface, j: Surface, T_i_j: Floats) -> Agreement:
    """Compares two views' surfaces at a pose."""
    a, b = seen_again(j, i, T_i_j), seen_again(i, j, inverse(T_i_j))
    return Agreement(
        compared=min(a.compared, b.compared),
        agree=min(a.agree, b.agree),
        mean_agree=0.5 * (a.agree + b.agree),
        through=max(a.through, b.through),
        overlap=0.5 * (a.visible * a.agree + b.visible * b.agree),
    )


def seen_again(source: Surface, target: Surface, T_target_source: Floats) -> SeenAgain:
    """Moves the source's sample into the target view and compares depths with the four nearest
    pixels there.
    """
    moved = transform(T_target_source, source.sample)
    z = moved[:, 2]
    ahead = z > 1e-6
    uv = (moved[ahead] @ target.K.T)[:, :2] / z[ahead, None]
    width, height = target.size
    inside = (uv >= 0).all(axis=1) & (uv[:, 0] < width) & (uv[:, 1] < height)
    uv, z = uv[inside], z[ahead][inside]
    visible = len(uv) / max(len(source.sample), 1)
    if len(uv) == 0:
        return SeenAgain(visible, 0, 0.0, 0.0)
    distance, near = target.tree.query(
        uv, k=min(4, target.tree.n), distance_upper_bound=_radius_px(target)
    )
    found = np.isfinite(distance.reshape(len(uv), -1))
    near = np.where(found, near.reshape(len(uv), -1), 0)
    compared = found[:, 0]
    if not compared.any():
        return SeenAgain(visible, 0, 0.0, 0.0)
    depths = np.where(found, target.z[near], np.nan)[compared]
    relative = (z[compared, None] - depths) / z[compared, None]
    sigma = float(np.hypot(source.depth_sigma, target.depth_sigma))
    agree = np.nanmin(np.abs(relative), axis=1) < max(0.02, 2.5 * sigma)
    through = np.nanmax(relative, axis=1) < -max(0.03, 4.0 * sigma)
    return SeenAgain(visible, int(compared.sum()), float(agree.mean()), float(through.mean()))
