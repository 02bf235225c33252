"""ICP of a pair's clouds from a pose, and what is told of it whether it is kept or not."""

import time
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.icp import (
    DenseCloud,
    SurfaceFit,
    by_open3d,
    gicp,
    open3d,
    plain_cloud,
    point_to_point,
    residual,
)
from fleetpose.pose_server.geometry.methods import IcpMethod
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PairIcpSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    # reach of ICP between surfaces from a pose that matches agree on, px at the median depth
    radius_px: float = 30.0
    # Of ICP between salient points, share of the depth: of 2, 5, 10 and 20 % this served the
    # paper's method best with three clicks
    points_radius: float = 0.02


PAIR_ICP = in_use("pair_icp", PairIcpSettings())

_FEWEST_POINTS = 3  # derived: points that determine a pose
_PLAIN = "plain_cloud"


@dataclass(frozen=True)
class IcpReport:
    """What ICP did to a pair.

    Attributes:
        method: gicp, point_to_point or point_to_plane.
        error_m2: sum of squared distances after it, of the points that have a partner.
        rms_m: their root mean square.
        count: of these points.
        ms: that it took.
        kept: whether the pose is what it made of it: else that was worse.
    """

    method: str
    error_m2: float
    rms_m: float
    count: int
    ms: float
    kept: bool


@dataclass(frozen=True, eq=False)
class Registered:
    """T_i_j (4, 4) after ICP, what is told of it, and how surfaces determine it, where they do."""

    T_i_j: Floats
    report: IcpReport
    fit: SurfaceFit | None = None


def registered(
    pair: Pair, T_i_j: Floats, method: IcpMethod, salient_only: bool = False
) -> Registered | None:
    """A pose after ICP: of the clouds where both are dense, else of the salient points; none where
    it is switched off or there are too few.
    """
    dense = pair.i.dense and pair.j.dense and not salient_only
    lifted = min(len(view.observed.lifted) for view in (pair.i, pair.j))
    if method == "off" or (not dense and lifted < _FEWEST_POINTS):
        return None
    if method != "gicp":
        open3d()  # its first import takes seconds, which are not ICP's
    began = time.perf_counter()
    fit: SurfaceFit | None = None
    if dense:
        i, j = pair.i.measured.for_icp, pair.j.measured.for_icp
        points_i, points_j = i.cloud.points()[:, :3], j.cloud.points()[:, :3]
        radius_m = PAIR_ICP.radius_px * pair.depth_m / pair.i.observed.focal_px
    else:
        points_i, points_j = salient(pair.i), salient(pair.j)
        i, j = _plain(pair.i, points_i), _plain(pair.j, points_j)
        radius_m = PAIR_ICP.points_radius * pair.depth_m
    if method != "gicp":
        T = by_open3d(points_i, points_j, T_i_j, radius_m, method)
    elif dense:
        fit = gicp(i, j, T_i_j, radius_m)
        T = fit.T_i_j
    else:
        method, T = "point_to_point", point_to_point(i, j, T_i_j, radius_m)
    left = residual(i, points_j, T, radius_m)
    ms = 1e3 * (time.perf_counter() - began)
    return Registered(T, IcpReport(method, left.error_m2, left.rms_m, left.count, ms, False), fit)


def salient(view: PreparedView) -> Floats:
    """(N, 3) salient points with depth, camera frame, metres."""
    return np.ascontiguousarray(view.observed.points[view.observed.lifted], np.float64)


def _plain(view: PreparedView, points: Floats) -> DenseCloud:
    if _PLAIN not in view.memo:
        view.memo[_PLAIN] = plain_cloud(points)
    return view.memo[_PLAIN]
