"""The paper's method alone: salient points, a linear start from the clicks, ICP. No verdict.

Its Fig. 7: the salient points of one view are moved by the transformation that Direct Linear
Transformation finds from the operator's correspondences (none: they stay), and the Iterative
Closest Point algorithm (Besl and McKay 1992) does the rest.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from evaluation.geometry import Floats
from pose_server.geometry import dlt
from pose_server.geometry.errors import DegenerateGeometryError
from pose_server.pairs.views import PreparedView

RADIUS_SHARE = 0.02
"""Correspondences farther apart are left out, share of the median depth. The paper does not say; of
2, 5, 10 and 20 %, on salient points or on whole clouds, this served it best with three clicks."""
ITERATIONS = 100
_FEWEST_POINTS = 3

Icp = Callable[[Floats, Floats, Floats, float], Floats]
"""From points (N, 3) of i and (M, 3) of j, a start T_i_j and a radius in metres to T_i_j."""


@dataclass(frozen=True)
class PaperPose:
    """T_i_j, the model that the clicks gave its start, and what it took."""

    T_i_j: Floats
    start: str
    icp_ms: float
    align_ms: float


def align(i: PreparedView, j: PreparedView, p_i: Floats, p_j: Floats) -> PaperPose:
    """Aligns two views by the paper's method.

    Args:
        i, j: the views; their salient points with depth are used.
        p_i, p_j: (N, 3) clicked points in both camera frames, metres; N may be 0.
    """
    began = time.perf_counter()
    T, model = start(p_i, p_j)
    start_ms = 1e3 * (time.perf_counter() - began)
    T, icp_ms = refined(i, j, T)
    return PaperPose(T, model, icp_ms, start_ms + icp_ms)


def refined(i: PreparedView, j: PreparedView, T_i_j: Floats) -> tuple[Floats, float]:
    """T_i_j by ICP on the salient points, from a start, and the milliseconds of ICP."""
    icp = icp_engine()[1]
    points_i, points_j = salient(i), salient(j)
    if min(len(points_i), len(points_j)) < _FEWEST_POINTS:
        return T_i_j, 0.0
    radius_m = RADIUS_SHARE * 0.5 * (i.median_depth_m + j.median_depth_m)
    began = time.perf_counter()
    T_i_j = icp(points_i, points_j, T_i_j, radius_m)
    return T_i_j, 1e3 * (time.perf_counter() - began)


def start(p_i: Floats, p_j: Floats) -> tuple[Floats, str]:
    """T_i_j from clicked points alone, and its model: translation for one or two, rigid for three,
    affine for four and more, of which the nearest rigid motion is taken. Identity for none.
    """
    if len(p_i) == 0:
        return np.eye(4), "identity"
    try:
        fit = dlt.fit(p_i, p_j, R_a_b=np.eye(3))
    except DegenerateGeometryError:
        return np.eye(4), "identity"
    return np.asarray(fit.T_a_b, np.float64), fit.model


def salient(view: PreparedView) -> Floats:
    """(N, 3) salient points with depth, camera frame, metres."""
    return np.ascontiguousarray(view.observed.points[view.observed.lifted], np.float64)


@cache
def icp_engine() -> tuple[str, Icp]:
    """Name and function of the point-to-point ICP: Open3D's, else small_gicp's.

    Open3D needs libraries of the system that may be missing.
    """
    try:
        import open3d  # noqa: F401
    except (ImportError, OSError):
        return "small_gicp", by_small_gicp
    return "open3d", by_open3d


def by_open3d(points_i: Floats, points_j: Floats, T_i_j: Floats, radius_m: float) -> Floats:
    """Point-to-point ICP of Open3D."""
    import open3d as o3d

    clouds = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for points in (points_j, points_i)
    ]
    registration = o3d.pipelines.registration
    result = registration.registration_icp(
        clouds[0],
        clouds[1],
        radius_m,
        T_i_j,
        registration.TransformationEstimationPointToPoint(),
        registration.ICPConvergenceCriteria(max_iteration=ITERATIONS),
    )
    return np.array(result.transformation, np.float64)


def by_small_gicp(points_i: Floats, points_j: Floats, T_i_j: Floats, radius_m: float) -> Floats:
    """Point-to-point ICP of small_gicp."""
    import small_gicp

    clouds = [small_gicp.PointCloud(points) for points in (points_i, points_j)]
    result = small_gicp.align(
        clouds[0],
        clouds[1],
        small_gicp.KdTree(clouds[0]),
        T_i_j,
        registration_type="ICP",
        max_correspondence_distance=radius_m,
        num_threads=1,
        max_iterations=ITERATIONS,
        translation_epsilon=1e-5 * radius_m,
        rotation_epsilon=1e-6,
    )
    return np.array(result.T_target_source, np.float64)
