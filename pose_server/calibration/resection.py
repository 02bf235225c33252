"""Where a camera stands by its pixels alone: three-point resection within RANSAC.

An alignment needs the depths of both views. Where those of one are wrong it fails, and says so; but
its pixels still fit the other's points, and that tells whose depths are off.
"""

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.se3 import transform

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]

_TRIANGLES = 200  # of three matches; with a third of them right, seven are right as a whole
_NEAR_PX_PER_FOCAL = 0.006  # what counts as the same pixel, as a share of the focal length
_LARGEST_ANGLE = 0.9999  # cosine of two rays that are too close to tell


def resection(
    source: Observed, target: Observed, matches: Indices
) -> tuple[Floats, npt.NDArray[np.bool_]] | None:
    """T_target_source by lifted points of the source and pixels of the target; the target's own
    depths are not used.

    Args:
        source, target: salient points.
        matches: (M, 2) of source and target indices, the most similar first; the source's points
            have a depth.

    Returns:
        The pose (4, 4) that most matches agree with, and which these are (M,); None without any.
    """
    if len(matches) < 6:
        return None
    points = source.points[matches[:, 0]]
    uv = target.uv[matches[:, 1]]
    rays = np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(target.K).T
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    rng = np.random.default_rng(len(matches))
    among = np.full((_TRIANGLES, 3), len(matches))
    among[::2] = max(len(matches) // 2, 6)  # of the more similar half more are right
    drawn = rng.integers(0, among)
    R, t = three_point_poses(points[drawn], rays[drawn])
    if len(R) == 0:
        return None
    bound_px = _NEAR_PX_PER_FOCAL * target.focal_px
    moved = points @ R.transpose(0, 2, 1) + t[:, None]  # (H, M, 3)
    z = np.maximum(moved[..., 2], 1e-9)
    offset = (moved @ target.K.T)[..., :2] / z[..., None] - uv
    agrees = (np.einsum("hmk,hmk->hm", offset, offset) < bound_px**2) & (moved[..., 2] > 0)
    best = int(agrees.sum(axis=1).argmax())
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R[best], t[best]
    return T, agrees[best]


def seen_at(
    source: Observed, target: Observed, matches: Indices, T_target_source: Floats
) -> npt.NDArray[np.bool_]:
    """Which matches (M,) a pose brings to nearly the same pixel of the target."""
    uv, z = target.project(transform(T_target_source, source.points[matches[:, 0]]))
    offset = np.linalg.norm(uv - target.uv[matches[:, 1]], axis=1)
    return (z > 0) & (offset < _NEAR_PX_PER_FOCAL * target.focal_px)


def three_point_poses(points: Floats, rays: Floats) -> tuple[Floats, Floats]:
    """All poses by which three points lie on three rays, for H triples at once.

    Grunert's equations as in Haralick et al. (International Journal of Computer Vision 1994).

    Args:
        points: (H, 3, 3) triples of points.
        rays: (H, 3, 3) unit directions from the camera.

    Returns:
        Rotations (S, 3, 3) and translations (S, 3) of points to the camera, up to four for each
        triple.
    """
    a2, b2, c2 = (_squared(points[:, m] - points[:, n]) for m, n in ((1, 2), (0, 2), (0, 1)))
    cos_a, cos_b, cos_c = (
        np.einsum("hk,hk->h", rays[:, m], rays[:, n]) for m, n in ((1, 2), (0, 2), (0, 1))
    )
    wide = np.maximum(np.maximum(cos_a, cos_b), cos_c) < _LARGEST_ANGLE
    a2, b2, c2, cos_a, cos_b, cos_c = (x[wide] for x in (a2, b2, c2, cos_a, cos_b, cos_c))
    points, rays = points[wide], rays[wide]
    p, q, r = (a2 - c2) / b2, (a2 + c2) / b2, c2 / b2
    quartic = np.column_stack(
        (
            (p - 1) ** 2 - 4 * r * cos_a**2,
            4 * (p * (1 - p) * cos_b - (1 - q) * cos_a * cos_c + 2 * r * cos_a**2 * cos_b),
            2
            * (
                p**2
                - 1
                + 2 * p**2 * cos_b**2
                + 2 * (1 - r) * cos_a**2
                - 4 * q * cos_a * cos_b * cos_c
                + 2 * (1 - a2 / b2) * cos_c**2
            ),
            4 * (-p * (1 + p) * cos_b + 2 * (a2 / b2) * cos_c**2 * cos_b - (1 - q) * cos_a * cos_c),
            (1 + p) ** 2 - 4 * (a2 / b2) * cos_c**2,
        )
    )
    triple, v = _positive_roots(quartic)
    p, b2, cos_a, cos_b, cos_c = (x[triple] for x in (p, b2, cos_a, cos_b, cos_c))
    with np.errstate(divide="ignore", invalid="ignore"):
        u = ((p - 1) * v**2 - 2 * p * cos_b * v + 1 + p) / (2 * (cos_c - v * cos_a))
        first = np.sqrt(b2 / (1 + v**2 - 2 * v * cos_b))
    good = np.isfinite(u) & np.isfinite(first) & (u > 0)
    lengths = np.column_stack((first, u * first, v * first))[good]
    seen = rays[triple[good]] * lengths[:, :, None]
    there = points[triple[good]]
    R = _axes(seen) @ _axes(there).transpose(0, 2, 1)
    return R, seen[:, 0] - np.einsum("hij,hj->hi", R, there[:, 0])


def _positive_roots(quartic: Floats) -> tuple[Indices, Floats]:
    """Rows and values of the positive real roots of quartics (H, 5), highest power first."""
    steep = np.abs(quartic[:, 0]) > 1e-9 * np.abs(quartic).max(axis=1)
    rows = np.flatnonzero(steep)
    companion = np.zeros((len(rows), 4, 4))
    companion[:, 1, 0] = companion[:, 2, 1] = companion[:, 3, 2] = 1.0
    companion[:, 0] = -quartic[rows, 1:] / quartic[rows, :1]
    roots = np.linalg.eigvals(companion)
    real = (np.abs(roots.imag) < 1e-3 * np.abs(roots)) & (roots.real > 1e-3)
    row, column = np.nonzero(real)
    return rows[row], roots.real[row, column]


def _axes(triangles: Floats) -> Floats:
    """Orthonormal axes (H, 3, 3), as columns, that are fixed to triangles (H, 3, 3)."""
    along = triangles[:, 1] - triangles[:, 0]
    normal = np.cross(along, triangles[:, 2] - triangles[:, 0])
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.stack((along, np.cross(normal, along), normal), axis=2)


def _squared(vectors: Floats) -> Floats:
    return np.maximum(np.einsum("hk,hk->h", vectors, vectors), 1e-18)
