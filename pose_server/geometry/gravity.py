"""Poses of two frames that both know where up is: what is left is a turn about it and a shift.

One point and a known turn give the shift, two points that do not stand above each other give all.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.se3 import exp_so3, hat, make_pose
from fleetpose.pose_server.geometry.spread import RANK_TOLERANCE, check_points

Floats = npt.NDArray[np.floating]

_UNIT_TOLERANCE = 1e-3  # numerical: rounding of a unit vector on the wire


@dataclass(frozen=True, eq=False)
class Gravity:
    """The direction against gravity in two frames.

    Attributes:
        up_a, up_b: (3,) unit vectors.
        sigma_rad: of the angle between them when brought together.

    Raises:
        DegenerateGeometryError: they are no unit vectors, or the sigma is not positive.
    """

    up_a: Floats
    up_b: Floats
    sigma_rad: float = 0.02

    def __post_init__(self) -> None:
        for up in (self.up_a, self.up_b):
            length = float(np.linalg.norm(up))
            if not abs(length - 1.0) < _UNIT_TOLERANCE:
                raise DegenerateGeometryError(f"up has length {length:.3g}, need 1")
        if not (np.isfinite(self.sigma_rad) and self.sigma_rad > 0):
            raise DegenerateGeometryError(f"sigma of up is {self.sigma_rad}, need more than 0")

    def level(self) -> Floats:
        """The shortest rotation R_a_b (3, 3) that brings up_b to up_a."""
        axis = np.cross(self.up_b, self.up_a)
        cosine = float(np.clip(self.up_b @ self.up_a, -1.0, 1.0))
        sine = float(np.linalg.norm(axis))
        if sine > 1e-9:
            return exp_so3(axis / sine * np.arctan2(sine, cosine))
        if cosine > 0:
            return np.eye(3)
        across = np.linalg.svd(self.up_b[None])[2][1]  # upside down: about any level axis
        return exp_so3(np.pi * across)

    def turned(self, yaw_rad: float) -> Floats:
        """R_a_b (3, 3) that brings up to up, turned about up_a from the shortest one."""
        return exp_so3(yaw_rad * self.up_a) @ self.level()


def shift_by_gravity(p_a: Floats, p_b: Floats, gravity: Gravity, yaw_rad: float) -> Floats:
    """T_a_b (4, 4) from one point or more and a known turn about up.

    Args:
        p_a, p_b: (N, 3) metres, N >= 1.
        gravity: in both frames.
        yaw_rad: about up_a, from the shortest rotation that brings up to up.

    Raises:
        DegenerateGeometryError: no points, or some are not finite.
    """
    p_a, p_b = check_points(p_a, p_b)
    R = gravity.turned(yaw_rad)
    return make_pose(R, p_a.mean(axis=0) - R @ p_b.mean(axis=0))


def pose_by_gravity(p_a: Floats, p_b: Floats, gravity: Gravity) -> Floats:
    """T_a_b (4, 4) from two points or more: the turn about up by least squares, then the shift.

    With q = p_b levelled, the angle maximises sum a . R(yaw) q over the horizontal parts: the
    planar case of Umeyama 1991, in closed form.

    Raises:
        DegenerateGeometryError: fewer than two points, not finite, or all above each other.
    """
    p_a, p_b = check_points(p_a, p_b)
    level, up = gravity.level(), gravity.up_a
    a, q = p_a - p_a.mean(axis=0), (p_b - p_b.mean(axis=0)) @ level.T
    horizontal = np.eye(3) - np.outer(up, up)
    across = min(float(np.linalg.norm(v @ horizontal)) for v in (a, q))
    whole = max(float(np.linalg.norm(v)) for v in (a, q))
    if across <= RANK_TOLERANCE * max(whole, 1e-300):
        raise DegenerateGeometryError(
            f"{len(p_a)} correspondences stand above each other: {across:.3g} m apart across up, "
            f"need {RANK_TOLERANCE * whole:.3g} m"
        )
    cosine = float(np.einsum("ni,ij,nj->", a, horizontal, q))
    sine = float(np.einsum("ni,ij,nj->", a, hat(up), q))
    R = exp_so3(np.arctan2(sine, cosine) * up) @ level
    return make_pose(R, p_a.mean(axis=0) - R @ p_b.mean(axis=0))
