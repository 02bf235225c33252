"""From which side is a surface seen? Planes through a view's cloud, and cameras before or behind
them.

A plane m . p = 1 is linear in the image: 1/z = m . (x, y, 1) at the ray (x, y, 1). So it is fitted
to inverse depths, where the noise of a stereo or depth camera is even. The camera that sees it
stands at m . 0 = 0, before it; another camera sees its front if its centre c has m . c < 1 too.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PatchesSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    centres: int = 250  # patches of a view
    neighbours: int = 16  # points of a patch
    # of a dense cloud, so that neighbours lie as far apart as those of a sparse one
    points: int = 2500
    flat: float = 0.015  # a patch whose inverse depths scatter by more than this share, or
    flat_sigmas: float = 2.0  # so many sigmas, is no plane
    decided_sigmas: float = 3.0  # by which a camera must be before or behind a plane


PATCHES = in_use("patches", PatchesSettings())


@dataclass(frozen=True)
class Patches:
    """Planes at some points of a view's cloud.

    Attributes:
        points: (P, 3) their middles, camera frame, metres.
        planes: (P, 3) m of m . p = 1, 1/m.
        spread: (P, 3, 3) covariance of the inverse depth's slope in x, in y, and of itself at the
            middle.
    """

    points: Floats
    planes: Floats
    spread: Floats

    def clearance(self, centres: Floats) -> tuple[Floats, Floats]:
        """How far (P,) a camera centre (3,) is before each plane, 1 at the own camera and negative
        behind it, and the sigma (P,) of that.
        """
        x = self.points[:, :2] / self.points[:, 2:]
        lever = np.column_stack((centres[:2] - x * centres[2], np.full(len(x), centres[2])))
        variance = np.einsum("pi,pij,pj->p", lever, self.spread, lever)
        return 1.0 - self.planes @ centres, np.sqrt(np.maximum(variance, 0.0))


@dataclass(frozen=True)
class Sides:
    """Of the surfaces that one view sees and that fall into the other's image: how many can be told
    to be before or behind its camera, and the share (0..1) that is seen from the front; 1 where
    none can be told.
    """

    told: int
    front: float


def patches_of(uv: Floats, z: Floats, K: Floats, depth_sigma: float) -> Patches:
    """Plane patches of a cloud.

    Args:
        uv: (N, 2) pixels, px.
        z: (N,) depths, metres.
        K: (3, 3) intrinsics, px.
        depth_sigma: relative sigma of a depth.
    """
    step = max(1, len(uv) // PATCHES.points)
    rays = (np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(K).T)[::step, :2]
    q = 1.0 / z[::step]
    if len(q) < PATCHES.neighbours:
        return Patches(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3)))
    centres = rays[:: max(1, len(rays) // PATCHES.centres)]
    near = cKDTree(rays).query(centres, k=PATCHES.neighbours)[1]
    A = np.concatenate((rays[near] - centres[:, None], np.ones((*near.shape, 1))), axis=2)
    normal = np.einsum("pki,pkj->pij", A, A)
    normal += 1e-12 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse_normal = np.linalg.inv(normal)
    slopes = np.einsum("pij,pkj,pk->pi", inverse_normal, A, q[near])
    off = np.einsum("pki,pi->pk", A, slopes) - q[near]
    scatter = np.sqrt((off * off).mean(axis=1)) / np.abs(slopes[:, 2])
    flat = (slopes[:, 2] > 0) & (scatter < max(PATCHES.flat, PATCHES.flat_sigmas * depth_sigma))
    sigma = np.maximum(scatter, depth_sigma) * slopes[:, 2]
    here, slopes = centres[flat], slopes[flat]
    planes = np.column_stack((slopes[:, :2], slopes[:, 2] - (slopes[:, :2] * here).sum(axis=1)))
    points = np.column_stack((here, np.ones(len(here)))) / slopes[:, 2:]
    return Patches(points, planes, inverse_normal[flat] * (sigma[flat] ** 2)[:, None, None])


def sides_seen(
    patches: Patches, T_target_source: Floats, K: Floats, size: tuple[int, int]
) -> Sides:
    """From which side a target camera with these intrinsics sees the patches of a source view."""
    moved = transform(T_target_source, patches.points)
    ahead = moved[:, 2] > 1e-6
    uv = (moved @ K.T)[:, :2] / np.where(ahead, moved[:, 2], np.inf)[:, None]
    seen = ahead & (uv >= 0).all(axis=1) & (uv < size).all(axis=1)
    before, sigma = patches.clearance(inverse(T_target_source)[:3, 3])
    told = seen & (np.abs(before) > PATCHES.decided_sigmas * sigma)
    count = int(told.sum())
    return Sides(count, float((before[told] > 0).mean()) if count else 1.0)
