"""The 3D point under a pixel, with its covariance: never a mean across a depth edge, never a guess
where there is no depth.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.geometry.noise import PointNoise, covariances

Floats = npt.NDArray[np.floating]

_SAME_SURFACE = 0.03  # relative difference of inverse depth on one surface
NEIGHBOURS = 12  # that a point is lifted from, at most
_CLICK_SIGMA_PX = 1.5


@dataclass(frozen=True)
class LiftedPoint:
    """A point in the camera frame.

    Attributes:
        p: (3,) metres.
        C: (3, 3) covariance, long along the ray.
        sigma_z: of the depth along the optical axis, metres.
    """

    p: Floats
    C: Floats
    sigma_z: float


def lift_pixel(
    pixel: Floats, uv: Floats, z: Floats, K: Floats, noise: PointNoise, radius_px: float
) -> LiftedPoint:
    """Lifts a pixel onto the surface of the points near it.

    A local plane in inverse depth (planes stay planes there) is fitted to the neighbours that lie
    on the same surface as the nearest one; it is drawn to a constant where the neighbours do not
    determine a slope.

    Args:
        pixel: (2,) where.
        uv: (N, 2) pixels of points with depth.
        z: (N,) their depths, metres.
        K: (3, 3) intrinsics.
        noise: of the camera.
        radius_px: how far the nearest point may be.

    Raises:
        DegenerateGeometryError: no point is near enough; the text says how far the nearest is.
    """
    if len(z) == 0:
        raise DegenerateGeometryError("no depth anywhere in this view")
    distance = np.linalg.norm(uv - pixel, axis=1)
    count = min(NEIGHBOURS, len(z))
    near = np.argpartition(distance, count - 1)[:count]
    near = near[np.argsort(distance[near])]
    if distance[near[0]] > radius_px:
        raise DegenerateGeometryError(
            f"no depth here, nearest usable point is {distance[near[0]]:.0f} px away"
        )
    q = 1.0 / z[near]
    same = (np.abs(q - q[0]) < _SAME_SURFACE * q[0]) & (distance[near] < 3 * radius_px)
    near, q = near[same], q[same]
    inverse_depth = _plane_at(uv[near] - pixel, q)
    depth = 1.0 / inverse_depth
    p = depth * np.linalg.inv(K) @ np.array([pixel[0], pixel[1], 1.0])
    # what the surface does between the pixel and the nearest point is not known
    unknown = 0.002 * depth * max(0.0, float(distance[near[0]]) - 0.75)
    sigma = float(np.hypot(noise.depth_sigma(np.array(depth)), unknown))
    C = covariances(p[None], float(K[0, 0]), _CLICK_SIGMA_PX, np.array([sigma]))[0]
    return LiftedPoint(p, C, sigma)


def _plane_at(offset: Floats, q: Floats) -> float:
    """Value at the origin of a weighted plane through (offset (N, 2), q (N,)), with a ridge on the
    slope.
    """
    weight = 1.0 / ((offset**2).sum(axis=1) + 1.0)
    X = np.column_stack((np.ones(len(q)), offset))
    A = (X * weight[:, None]).T @ X + np.diag([1e-9, 2.0, 2.0])
    level = float(q[0] + np.linalg.solve(A, (X * weight[:, None]).T @ (q - q[0]))[0])
    limit = _SAME_SURFACE * q[0]
    return float(np.clip(level, q[0] - limit, q[0] + limit))
