"""How well a point is known: long along its ray, thin across it."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtri

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PointNoise:
    """A camera's noise: pixels in the image, metres along the ray.

    Attributes:
        pixel_sigma_px: sigma of a salient point in the image.
        depth_sigma_m: (c0, c1, c2) of sigma(z) = c0 + c1 z + c2 z^2.
    """

    pixel_sigma_px: float
    depth_sigma_m: tuple[float, float, float]

    def depth_sigma(self, z: Floats) -> Floats:
        """Sigma along the ray (...,) in metres at depth z."""
        c0, c1, c2 = self.depth_sigma_m
        return c0 + c1 * z + c2 * z * z


def covariances(
    points: Floats, focal_px: float, pixel_sigma_px: Floats | float, depth_sigma_m: Floats
) -> Floats:
    """(N, 3, 3) covariances in the camera frame of points (N, 3) from pixel and depth sigmas
    (N,).
    """
    ray = points / points[:, 2:3]
    across = (pixel_sigma_px * points[:, 2] / focal_px) ** 2
    along = ray[:, :, None] * ray[:, None, :] * (depth_sigma_m**2)[:, None, None]
    return across[:, None, None] * np.eye(3) + along


def chi2_limit(outside: float, dof: int) -> float:
    """The squared Mahalanobis distance that this share of right ones exceeds."""
    return float(chdtri(dof, outside))  # scipy.stats says the same, and takes 0.3 s to import
