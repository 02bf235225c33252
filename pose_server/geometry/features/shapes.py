"""What the surface around a point looks like: fast point feature histograms (Rusu et al., ICRA
2009) of the points where a surface bends most; on flat ones all points look alike.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import small_gicp
from numba import njit
from scipy.spatial import cKDTree

from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class ShapesSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    normal_neighbours: int = 15  # points that a normal is told by
    radius: float = 5.0  # of what a histogram looks at, in resolutions
    most_points: int = 1500  # points of a view that have a shape, the most bent first


SHAPES = in_use("shapes", ShapesSettings())

_BINS = 11  # cited: of each of the three angles (FPFH, Rusu 2009)


@dataclass(frozen=True)
class Shapes:
    """Points (N, 3) of a cloud and descriptors (N, 33) of unit length, float32."""

    points: Floats
    descriptors: npt.NDArray[np.float32]


def shapes_of(points: Floats, resolution: float) -> Shapes:
    """The shapes of a cloud (N, 3), seen from the origin; all in one unit."""
    cloud = small_gicp.voxelgrid_sampling(points, resolution)
    small_gicp.estimate_normals(cloud, num_neighbors=SHAPES.normal_neighbours)
    p = np.ascontiguousarray(cloud.points()[:, :3])
    normals = np.ascontiguousarray(cloud.normals()[:, :3])
    near = cKDTree(p).query_pairs(SHAPES.radius * resolution, output_type="ndarray")
    near = np.ascontiguousarray(near, np.int64)
    simple, bend = _simple_histograms(p, normals, near)
    bent = np.argsort(-bend, kind="stable")[: SHAPES.most_points]
    chosen = np.full(len(p), -1, np.int64)
    chosen[bent] = np.arange(len(bent))
    histograms = _with_neighbours(p, near, simple, chosen, len(bent), resolution)
    blocks = histograms.reshape(len(bent), 3, _BINS)
    blocks = blocks / np.maximum(blocks.sum(axis=2, keepdims=True), 1e-12)
    roots = np.sqrt(blocks.reshape(len(bent), -1))  # Hellinger distance, as for SIFT
    roots /= np.maximum(np.linalg.norm(roots, axis=1, keepdims=True), 1e-12)
    return Shapes(p[bent], roots.astype(np.float32))


@njit("i8(f8, f8, f8)", cache=True, inline="always")
def _bin(value: float, low: float, high: float) -> int:
    return min(max(int((value - low) / (high - low) * _BINS), 0), _BINS - 1)


@njit("Tuple((f8[:, ::1], f8[::1]))(f8[:, ::1], f8[:, ::1], i8[:, ::1])", cache=True)
def _simple_histograms(p: Floats, normals: Floats, near: Indices) -> tuple[Floats, Floats]:
    """Histograms (N, 33) of the angles between each point's normal, its neighbours' and the way
    there; and how far the neighbours' normals turn away on average (N,).
    """
    histograms = np.zeros((len(p), 3 * _BINS))
    bend, count = np.zeros(len(p)), np.zeros(len(p))
    for e in range(near.shape[0]):
        for way in range(2):
            a, b = near[e, way], near[e, 1 - way]
            d0, d1, d2 = p[b, 0] - p[a, 0], p[b, 1] - p[a, 1], p[b, 2] - p[a, 2]
            length = np.sqrt(d0 * d0 + d1 * d1 + d2 * d2)
            u0, u1, u2 = normals[a, 0], normals[a, 1], normals[a, 2]
            n0, n1, n2 = normals[b, 0], normals[b, 1], normals[b, 2]
            cosine = u0 * n0 + u1 * n1 + u2 * n2
            bend[a] += 1 - abs(cosine)
            count[a] += 1
            v0, v1, v2 = d1 * u2 - d2 * u1, d2 * u0 - d0 * u2, d0 * u1 - d1 * u0
            across = np.sqrt(v0 * v0 + v1 * v1 + v2 * v2)
            if across < 1e-9 * length:
                continue
            v0, v1, v2 = v0 / across, v1 / across, v2 / across
            w0, w1, w2 = u1 * v2 - u2 * v1, u2 * v0 - u0 * v2, u0 * v1 - u1 * v0
            alpha = v0 * n0 + v1 * n1 + v2 * n2
            phi = (u0 * d0 + u1 * d1 + u2 * d2) / length
            theta = np.arctan2(w0 * n0 + w1 * n1 + w2 * n2, cosine)
            histograms[a, _bin(alpha, -1.0, 1.0)] += 1
            histograms[a, _BINS + _bin(phi, -1.0, 1.0)] += 1
            histograms[a, 2 * _BINS + _bin(theta, -np.pi, np.pi)] += 1
    for a in range(len(p)):
        histograms[a] /= max(count[a], 1.0)
        bend[a] /= max(count[a], 1.0)
    return histograms, bend


@njit("f8[:, ::1](f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[::1], i8, f8)", cache=True)
def _with_neighbours(
    p: Floats, near: Indices, simple: Floats, chosen: Indices, count: int, resolution: float
) -> Floats:
    """Histograms of the chosen points (their places in the answer, -1 for the others) with those of
    their neighbours, the nearer the more.
    """
    out, weights = np.zeros((count, simple.shape[1])), np.zeros(count)
    for e in range(near.shape[0]):
        for way in range(2):
            a, b = near[e, way], near[e, 1 - way]
            place = chosen[a]
            if place < 0:
                continue
            d = 0.0
            for k in range(3):
                d += (p[b, k] - p[a, k]) ** 2
            weight = resolution / max(np.sqrt(d), 0.1 * resolution)
            weights[place] += weight
            for k in range(simple.shape[1]):
                out[place, k] += weight * simple[b, k]
    for a in range(len(p)):
        if chosen[a] >= 0:
            place = chosen[a]
            for k in range(simple.shape[1]):
                out[place, k] = simple[a, k] + out[place, k] / max(weights[place], 1e-12)
    return out
