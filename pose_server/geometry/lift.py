"""The 3D point under a pixel, with its covariance: never a mean across a depth edge, never a guess
where there is no depth.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.noise import PointNoise, covariances
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class LiftSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    click_sigma_px: float = 1.5  # of a person's click, in either image
    neighbours: int = 12  # that a point is lifted from, at most
    same_surface: float = 0.03  # relative difference of inverse depth on one surface
    reach: float = 3.0  # radii within which neighbours count
    # share of the depth that a surface may leave its plane, per pixel of gap
    unknown_per_px: float = 0.002
    known_within_px: float = 0.75  # nearer than this a point is as good as under the click


LIFT = in_use("lift", LiftSettings())


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

    The neighbours are told apart by surface; the surface that speaks loudest at the pixel is
    taken, and a local plane in inverse depth (planes stay planes there) is fitted to it. The plane
    is drawn to a constant where the neighbours do not determine a slope. The depth's sigma covers
    the camera's noise, what the slope makes of a hand's noise, the gap to the nearest point, and
    the chance that one of the other surfaces was meant.

    Args:
        pixel: (2,) where.
        uv: (N, 2) pixels of points with depth.
        z: (N,) their depths, metres; what is not finite and positive is no depth.
        K: (3, 3) intrinsics.
        noise: of the camera.
        radius_px: how far the nearest point may be.

    Raises:
        DegenerateGeometryError: no point is near enough; the text says how far the nearest is.
            The pixel is not finite.
    """
    if not np.isfinite(pixel).all():
        raise DegenerateGeometryError(f"pixel {pixel} is not finite")
    usable = np.isfinite(z) & (z > 0) & np.isfinite(uv).all(axis=1)
    if not usable.all():
        uv, z = uv[usable], z[usable]
    if len(z) == 0:
        raise DegenerateGeometryError("no depth anywhere in this view")
    distance = np.linalg.norm(uv - pixel, axis=1)
    count = min(LIFT.neighbours, len(z))
    near = np.argpartition(distance, count - 1)[:count]
    near = near[np.argsort(distance[near])]
    if distance[near[0]] > radius_px:
        raise DegenerateGeometryError(
            f"no depth here, nearest usable point is {distance[near[0]]:.0f} px away"
        )
    near = near[distance[near] < LIFT.reach * radius_px]
    q, weight = 1.0 / z[near], 1.0 / (distance[near] ** 2 + LIFT.click_sigma_px**2)
    own = _loudest_surface(q, weight)
    level, slope = _plane_at(uv[near[own]] - pixel, q[own])
    depth = 1.0 / level
    p = depth * np.linalg.inv(K) @ np.array([pixel[0], pixel[1], 1.0])
    gap_px = max(0.0, float(distance[near[own]][0]) - LIFT.known_within_px)
    other2 = float(weight[~own] @ (z[near[~own]] - depth) ** 2) / float(weight.sum())
    sigma = float(
        np.sqrt(
            noise.depth_sigma(np.array(depth)) ** 2
            + (LIFT.unknown_per_px * depth * gap_px) ** 2
            + (LIFT.click_sigma_px * slope * depth**2) ** 2
            + other2
        )
    )
    C = covariances(p[None], float(K[0, 0]), LIFT.click_sigma_px, np.array([sigma]))[0]
    return LiftedPoint(p, C, sigma)


def _loudest_surface(q: Floats, weight: Floats) -> npt.NDArray[np.bool_]:
    """Which neighbours lie on the surface with the largest weight, told apart by inverse depth
    (N,); of equals, that of the nearest. A lone wrong depth under the click is so outvoted.
    """
    alike = np.abs(q[:, None] - q) < LIFT.same_surface * q
    return alike[:, int(np.argmax(weight @ alike))]


def _plane_at(offset: Floats, q: Floats) -> tuple[float, float]:
    """Value at the origin, and steepness per pixel, of a weighted plane through (offset (N, 2),
    q (N,)), with a ridge on the slope; the value stays within the surface.
    """
    weight = 1.0 / ((offset**2).sum(axis=1) + 1.0)
    X = np.column_stack((np.ones(len(q)), offset))
    A = (X * weight[:, None]).T @ X + np.diag([1e-9, 2.0, 2.0])
    middle = float(np.median(q))
    plane = np.linalg.solve(A, (X * weight[:, None]).T @ (q - middle))
    limit = LIFT.same_surface * middle
    level = middle + float(np.clip(plane[0], -limit, limit))
    return level, float(np.hypot(plane[1], plane[2]))
