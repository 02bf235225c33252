"""Poses from matched points of which most may be wrong: triangles that are the same in both views.

Two right matches keep the distance of their points; two matches that do, within the noise of all
four points, are compatible. Two right ones are compatible with many others in common, two wrong
ones with few (Chen et al., SC2-PCR, CVPR 2022): the pairs with the most common ones come first, and
each is completed by some of these to a triangle, which gives a pose. A pose is scored by where it
moves all points: near to the measured pixel, loosely near in depth. Directions are known far
better than depths, so that this tells right poses with a few dozen matches among hundreds from
what merely clusters in space.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]
Bits = npt.NDArray[np.uint64]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class TrianglesSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    poses: int = 8  # poses that are told, at most
    most_matches: int = 600  # matches that are looked at: compatibility takes time by their square
    edges: int = 500  # edges that triangles begin from, the most common first
    thirds: int = 3  # third corners of each
    # of the largest possible score: most matches agree, and refinement does the rest
    enough: float = 0.3
    sigmas: float = 3.5  # by which compatible distances may differ
    lateral: float = 0.002  # sigma of a point across its ray, share of the depth
    shortest: float = 0.05  # edge of a triangle, share of the depth
    near: float = 0.006  # of a measured direction, radians: a pose by three points is a coarse one
    # at least and at most, shares; three sigmas in between
    near_depth: tuple[float, float] = (0.015, 0.06)
    apart: float = 0.15  # poses nearer to each other than this count once, share of the depth


TRIANGLES = in_use("triangles", TrianglesSettings())

_FLATTEST = 0.15  # compiled: sine of its angle at the first corner


def poses_by_triangles(
    i: Observed, j: Observed, matches: Indices, depth_m: float
) -> list[tuple[Floats, Indices]]:
    """Coarse T_i_j with the matches that agree on them, the best first.

    Args:
        i, j: the points.
        matches: (M, 2) of lifted points, the most trusted first; those beyond
            `MOST_MATCHES` are not looked at.
        depth_m: of the scene.
    """
    matches = matches[: TRIANGLES.most_matches]
    if len(matches) < 3:
        return []
    at_i, at_j = matches.T
    p_i, p_j = (np.ascontiguousarray(v.points[at]) for v, at in ((i, at_i), (j, at_j)))
    sigmas = [v.inverse_depth_sigma[at] / v.inverse_depth[at] for v, at in ((i, at_i), (j, at_j))]
    shortest = TRIANGLES.shortest * depth_m
    bits = _compatible(
        p_i,
        p_j,
        (sigmas[0] * p_i[:, 2]) ** 2,
        (sigmas[1] * p_j[:, 2]) ** 2,
        4 * (TRIANGLES.lateral * depth_m) ** 2,
        TRIANGLES.sigmas**2,
        shortest,
    )
    edges, common = _edges(bits)
    first = np.argsort(-common, kind="stable")[: TRIANGLES.edges]
    near_depth = float(np.clip(3 * np.median(np.hypot(*sigmas)), *TRIANGLES.near_depth))
    near_px = TRIANGLES.near * i.focal_px
    uv, inverse_depth = (
        np.ascontiguousarray(i.uv[at_i]),
        np.ascontiguousarray(i.inverse_depth[at_i]),
    )
    scores, poses = _best_poses(
        p_i,
        p_j,
        uv,
        inverse_depth,
        np.array(i.K, np.float64),
        bits,
        edges[first],
        TRIANGLES.thirds,
        near_px,
        near_depth,
        TRIANGLES.apart * depth_m,
        TRIANGLES.poses,
        TRIANGLES.enough * len(matches),
    )
    found = []
    for T in poses[np.argsort(-scores)][: int((scores > 0).sum())]:
        moved_uv, z = i.project(transform(T, p_j))
        off = np.hypot(
            np.linalg.norm(moved_uv - uv, axis=1) / near_px, (z * inverse_depth - 1) / near_depth
        )
        found.append((T, matches[(off < 1) & (z > 0)]))
    return found


@njit("Tuple((f8, f8, f8))(f8[:, ::1], i8, i8)", cache=True, inline="always")
def _from_to(points: Floats, a: int, b: int) -> Vector:
    return (
        points[b, 0] - points[a, 0],
        points[b, 1] - points[a, 1],
        points[b, 2] - points[a, 2],
    )


@njit(cache=True, inline="always")
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit("f8(f8[:, ::1], f8[::1], i8, i8, UniTuple(f8, 3), f8)", cache=True, inline="always")
def _edge_variance(
    points: Floats, along: Floats, a: int, b: int, edge: Vector, length2: float
) -> float:
    """Variance of the length of an edge by what its ends vary along their rays; `along` is per
    squared distance of the point.
    """
    at_a = edge[0] * points[a, 0] + edge[1] * points[a, 1] + edge[2] * points[a, 2]
    at_b = edge[0] * points[b, 0] + edge[1] * points[b, 1] + edge[2] * points[b, 2]
    return (at_a * at_a * along[a] + at_b * at_b * along[b]) / length2


@njit("u8[:, ::1](f8[:, ::1], f8[:, ::1], f8[::1], f8[::1], f8, f8, f8)", cache=True)
def _compatible(
    P: Floats,
    Q: Floats,
    variance_p: Floats,
    variance_q: Floats,
    lateral_variance: float,
    chi2: float,
    shortest: float,
) -> Bits:
    """Which matches (M, 3) keep their distance, as rows of M bits; variances (M,) are those along
    the rays.
    """
    count = P.shape[0]
    bits = np.zeros((count, (count + 63) // 64), np.uint64)
    one = np.uint64(1)
    along_p, along_q = np.empty(count), np.empty(count)
    for a in range(count):
        along_p[a] = variance_p[a] / (P[a, 0] ** 2 + P[a, 1] ** 2 + P[a, 2] ** 2)
        along_q[a] = variance_q[a] / (Q[a, 0] ** 2 + Q[a, 1] ** 2 + Q[a, 2] ** 2)
    for a in range(count):
        for b in range(a + 1, count):
            p, q = _from_to(P, a, b), _from_to(Q, a, b)
            p2, q2 = _dot(p, p), _dot(q, q)
            if p2 < shortest * shortest or q2 < shortest * shortest:
                continue
            variance = lateral_variance
            variance += _edge_variance(P, along_p, a, b, p, p2)
            variance += _edge_variance(Q, along_q, a, b, q, q2)
            if (np.sqrt(p2) - np.sqrt(q2)) ** 2 < chi2 * variance:
                bits[a, b >> 6] |= one << np.uint64(b & 63)
                bits[b, a >> 6] |= one << np.uint64(a & 63)
    return bits


@njit("u8(u8)", cache=True, inline="always")
def _ones(word: int) -> int:
    """How many bits of a word are set."""
    x = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)  # type: ignore[return-value]


@njit("Tuple((i8[:, ::1], i8[::1]))(u8[:, ::1])", cache=True)
def _edges(bits: Bits) -> tuple[Indices, Indices]:
    """Pairs of compatible matches (E, 2), and with how many others both are compatible."""
    count, words = bits.shape
    total = 0
    for a in range(count):
        for w in range(words):
            total += _ones(bits[a, w])
    edges, common = np.empty((total // 2, 2), np.int64), np.zeros(total // 2, np.int64)
    e = 0
    for a in range(count):
        for b in range(a + 1, count):
            if (bits[a, b >> 6] >> np.uint64(b & 63)) & np.uint64(1):
                for w in range(words):
                    common[e] += _ones(bits[a, w] & bits[b, w])
                edges[e, 0], edges[e, 1] = a, b
                e += 1
    return edges, common


@njit("b1(f8[:, ::1], i8, i8, i8, f8[:, ::1])", cache=True)
def _axes(points: Floats, a: int, b: int, c: int, out: Floats) -> bool:
    """Writes the frame (3, 3) of a triangle: along its first edge, within it, across it; False if
    it is too flat.
    """
    x, h = _from_to(points, a, b), _from_to(points, a, c)
    z = (
        x[1] * h[2] - x[2] * h[1],
        x[2] * h[0] - x[0] * h[2],
        x[0] * h[1] - x[1] * h[0],
    )
    long, high, area = np.sqrt(_dot(x, x)), np.sqrt(_dot(h, h)), np.sqrt(_dot(z, z))
    if area < _FLATTEST * long * high:
        return False
    for k in range(3):
        out[k, 0], out[k, 2] = x[k] / long, z[k] / area
    out[0, 1] = out[1, 2] * out[2, 0] - out[2, 2] * out[1, 0]
    out[1, 1] = out[2, 2] * out[0, 0] - out[0, 2] * out[2, 0]
    out[2, 1] = out[0, 2] * out[1, 0] - out[1, 2] * out[0, 0]
    return True


@njit("b1(f8[:, ::1], f8[:, ::1], i8, i8, i8, f8[:, ::1], f8[:, ::1], f8[:, ::1])", cache=True)
def _pose(P: Floats, Q: Floats, a: int, b: int, c: int, A: Floats, B: Floats, out: Floats) -> bool:
    """Writes the pose (4, 4) that moves one triangle onto the other, middle onto middle; A and B
    are scratch.
    """
    if not (_axes(P, a, b, c, A) and _axes(Q, a, b, c, B)):
        return False
    for r in range(3):
        for k in range(3):
            out[r, k] = A[r, 0] * B[k, 0] + A[r, 1] * B[k, 1] + A[r, 2] * B[k, 2]
        out[r, 3] = (P[a, r] + P[b, r] + P[c, r]) / 3
        for k in range(3):
            out[r, 3] -= out[r, k] * (Q[a, k] + Q[b, k] + Q[c, k]) / 3
    return True


@njit("f8(f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1], f8[:, ::1], f8, f8)", cache=True)
def _score(
    Q: Floats,
    uv: Floats,
    inverse_depth: Floats,
    K: Floats,
    T: Floats,
    near_px: float,
    near_depth: float,
) -> float:
    """How many moved points are near what was measured, each counting the more the nearer."""
    total = 0.0
    for m in range(Q.shape[0]):
        z = T[2, 0] * Q[m, 0] + T[2, 1] * Q[m, 1] + T[2, 2] * Q[m, 2] + T[2, 3]
        if z <= 0:
            continue
        deep = (z * inverse_depth[m] - 1) / near_depth
        if abs(deep) > 1:
            continue
        x = T[0, 0] * Q[m, 0] + T[0, 1] * Q[m, 1] + T[0, 2] * Q[m, 2] + T[0, 3]
        u = (K[0, 0] * x / z + K[0, 2] - uv[m, 0]) / near_px
        if abs(u) > 1:
            continue
        y = T[1, 0] * Q[m, 0] + T[1, 1] * Q[m, 1] + T[1, 2] * Q[m, 2] + T[1, 3]
        v = (K[1, 1] * y / z + K[1, 2] - uv[m, 1]) / near_px
        total += max(0.0, 1 - u * u - v * v - deep * deep)
    return total


@njit(
    "Tuple((f8[::1], f8[:, :, ::1]))(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8[:, ::1],"
    " u8[:, ::1], i8[:, ::1], i8, f8, f8, f8, i8, f8)",
    cache=True,
)
def _best_poses(
    P: Floats,
    Q: Floats,
    uv: Floats,
    inverse_depth: Floats,
    K: Floats,
    bits: Bits,
    edges: Indices,
    thirds: int,
    near_px: float,
    near_depth: float,
    apart: float,
    kept: int,
    enough: float,
) -> tuple[Floats, Floats]:
    """Scores (kept,), 0 for none, and poses (kept, 4, 4) of the best triangles on the edges (E, 2),
    each with so many thirds of those that are compatible with both ends; no more are tried once one
    scores enough.
    """
    scores, poses = np.zeros(kept), np.zeros((kept, 4, 4))
    A, B, T = np.empty((3, 3)), np.empty((3, 3)), np.eye(4)
    common = np.empty(P.shape[0], np.int64)
    np.random.seed(1)  # the same answer every time
    for e in range(edges.shape[0]):
        a, b = edges[e, 0], edges[e, 1]
        found = 0
        for c in range(P.shape[0]):
            word, bit = c >> 6, np.uint64(c & 63)
            if ((bits[a, word] & bits[b, word]) >> bit) & np.uint64(1):
                common[found] = c
                found += 1
        for _ in range(min(thirds, found)):
            if not _pose(P, Q, a, b, common[np.random.randint(found)], A, B, T):
                continue
            score = _score(Q, uv, inverse_depth, K, T, near_px, near_depth)
            if score <= scores.min():
                continue
            place = -1  # of the best one that is the same
            for k in range(kept):
                if scores[k] > 0 and (place < 0 or scores[k] > scores[place]):
                    d = poses[k, :3, 3] - T[:3, 3]
                    if d[0] * d[0] + d[1] * d[1] + d[2] * d[2] < apart * apart:
                        place = k
            if place < 0:
                place = int(scores.argmin())
            elif score <= scores[place]:
                continue
            scores[place] = score
            poses[place] = T
        if scores.max() > enough:
            break
    return scores, poses
