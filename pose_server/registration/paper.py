"""The method as published: salient points, a linear start from the clicks, ICP. No features, no
verdict.

Its Fig. 7: the salient points of one view are moved by the transformation H* that Direct Linear
Transformation finds from the operator's correspondences (none: they stay), and the Iterative
Closest Point algorithm (Besl and McKay 1992) does the rest, at each new image. A pair whose
regression error is above a threshold is taken to share nothing.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry import dlt
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.icp import has_open3d
from fleetpose.pose_server.registration.operator_starts import FULL_POSE, Clicks, point_pairs
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.pair_icp import Registered, registered
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult, regression_error
from fleetpose.pose_server.registration.verdict.hearing import ByClicks, Hearing
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PaperSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    # Share of the median depth: two thirds of the distance (.03, or more for noisy depths) at
    # which the regression error counts a point as having no partner. Not fitted: the paper names
    # no threshold
    most_rmse: float = 0.02
    sigma: float = 0.01  # of its poses, share of the depth and radians: the method states none
    p_grave: float = 0.01  # the method states none: everything that is shown is taken to be so


PAPER = in_use("paper", PaperSettings())


@dataclass(frozen=True)
class LinearStart:
    """T_i_j (4, 4) from clicks, and the model that they determine; identity for none."""

    T_i_j: Floats
    model: str


def linear_start(p_i: Floats, p_j: Floats) -> LinearStart:
    """From clicked points (N, 3) of both views: a translation for one or two, rigid for three,
    affine for four and more, of which the nearest rigid motion is taken.
    """
    if len(p_i) == 0:
        return LinearStart(np.eye(4), "identity")
    try:
        fit = dlt.fit(p_i, p_j, R_a_b=np.eye(3))
    except DegenerateGeometryError:
        return LinearStart(np.eye(4), "identity")
    return LinearStart(np.asarray(fit.T_a_b, np.float64), fit.model)


def by_icp(i: PreparedView, j: PreparedView, T_i_j: Floats) -> Registered | None:
    """A pose after ICP from salient point to salient point; none where there are too few."""
    how = "point_to_point" if has_open3d() else "gicp"
    return registered(Pair(i, j, PAIR.ratio), T_i_j, how, salient_only=True)


def align_as_published(
    i: PreparedView, j: PreparedView, clicks: Clicks | None, known: Sequence[Start]
) -> PairResult:
    """Aligns two views.

    Args:
        i, j: the views.
        clicks: between them; none: they may be known from earlier.
        known: poses to begin from where nobody clicked, the best first; none: identity.
    """
    began = time.perf_counter()
    told: ByClicks | None = None
    T = known[0].T_i_j if known else np.eye(4)
    if clicks is not None:
        pairs = point_pairs(i, j, clicks)
        linear = linear_start(pairs.p_a, pairs.p_b)
        ids = tuple(one for one, _ in clicks.ids) or tuple(range(len(pairs)))
        T, told = linear.T_i_j, ByClicks(linear.T_i_j, linear.model, ids)
    found = by_icp(i, j, T)
    if found is None:
        return PairResult(None, None, "rejected", ("too few salient points for ICP",))
    pair = Pair(i, j, PAIR.ratio)
    error_m2, count = regression_error(pair, found.T_i_j)
    rmse_m = float(np.sqrt(error_m2 / count)) if count else 0.0
    most_m = PAPER.most_rmse * pair.depth_m
    shown = count > 0 and rmse_m < most_m
    result = PairResult(
        T_i_j=found.T_i_j,
        covariance=PAPER.sigma**2 * np.diag(np.repeat((1.0, pair.depth_m**2), 3)),
        verdict="verified" if shown else "rejected",
        reasons=(
            f"regression error {rmse_m:.3g} m, {'below' if shown else 'not below'} {most_m:.3g} m: "
            "nothing else is asked",
        ),
        inliers=found.report.count,
        overlap=pair.agreement(found.T_i_j).overlap,
        rmse_m=rmse_m,
        regression_error_m2=error_m2,
        regression_count=count,
        start=told.model if told else (known[0].kind if known else "identity"),
        timings_ms={"paper": 1e3 * (time.perf_counter() - began)},
        p_grave=PAPER.p_grave if shown else 1.0,
        by_clicks=told,
        icp=replace(found.report, kept=True),
    )
    return result if clicks is None else _with_clicks(result, clicks, shown)


def _with_clicks(result: PairResult, clicks: Clicks, shown: bool) -> PairResult:
    """All clicks are taken for right; three of them and more make a pose."""
    enough = shown and len(clicks.z_i) >= FULL_POSE
    hearing = Hearing((True,) * len(clicks.z_i), PAPER.p_grave if enough else 1.0)
    return replace(result, confirmed=enough, grown=enough, hearing=hearing)
