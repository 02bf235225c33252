"""What an alignment tells besides the pose: whether the depths of two robots' views fit each other,
and which points an operator might confirm; of two views of one robot, what moves and whether depths
and image are of one moment.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.depth_comparison import DepthErrors, compare_depths
from fleetpose.pose_server.calibration.depth_shift import DepthShift, depth_shift
from fleetpose.pose_server.frontend.moving_points import moving_masks
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView
from fleetpose.pose_server.registration.suggested_points import suggested
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.registration.verdict.fitted_model import MODEL
from fleetpose.pose_server.registration.verdict.grave_probability import contrast
from fleetpose.pose_server.registration.verdict.mirrored import REASON, is_mirrored
from fleetpose.pose_server.tuned import in_use


@dataclass(frozen=True)
class DiagnosticsSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    lacking: float = -1.0  # sigmas: what explains less than most right poses may be a mirror image
    far: float = 0.5  # median depth over depth
    at_place: float = 0.012  # share of the focal length: matches that are where the pose says


DIAGNOSTICS = in_use("diagnostics", DiagnosticsSettings())


def with_byproducts(pair: Pair, result: PairResult) -> PairResult:
    """The result with what else the two views tell."""
    if pair.i.name.robot == pair.j.name.robot:
        moving = moving_masks(pair, result)
        return replace(result, moving=moving, shift=shift_of(pair, result))
    result = with_mirror(pair, result)
    return with_suggestions(pair, replace(result, depths=depths_of(pair, result)))


def with_mirror(pair: Pair, result: PairResult) -> PairResult:
    """The result, refused where the views fit far better if one of them is mirrored."""
    e = result.evidence
    if (
        e is not None
        and result.verdict == "verified"
        and contrast(MODEL, e)[:2].min() > DIAGNOSTICS.lacking
    ):
        return result
    if not is_mirrored(pair, 0 if e is None else e.ratio_inliers):
        return result
    return replace(
        result,
        verdict="rejected",
        reasons=(REASON, *result.reasons),
        p_grave=1.0,
        mirrored=True,
    )


def with_suggestions(pair: Pair, result: PairResult) -> PairResult:
    """The result with points for an operator to confirm, where it is not verified."""
    if result.verdict == "verified":
        return replace(result, suggested=None)
    return replace(result, suggested=suggested(pair, result.T_i_j))


def depths_of(pair: Pair, result: PairResult) -> DepthErrors | None:
    """Compares the depths of two robots' views at their pose, or, where the alignment has none to
    trust, at the one that their pixels find: wrong depths are a reason for having none.
    """
    matches = pair.ratio[_near(pair.i, pair.ratio[:, 0]) | _near(pair.j, pair.ratio[:, 1])]
    T_i_j = result.T_i_j if result.verdict == "verified" else None
    return compare_depths(pair.i.observed, pair.j.observed, matches, T_i_j)


def shift_of(pair: Pair, result: PairResult) -> DepthShift | None:
    """Where the depths of the later view of a robot fit its image best, by what the earlier view's
    points say of them.
    """
    if result.T_i_j is None or result.verdict not in ("verified", "plausible"):
        return None
    i, j = pair.i.observed, pair.j.observed
    at_i, at_j = pair.ratio.T
    seen, z = j.project(transform(inverse(result.T_i_j), i.points[at_i]))
    off_px = np.linalg.norm(seen - j.uv[at_j], axis=1)
    good = (z > 0) & (off_px < DIAGNOSTICS.at_place * j.focal_px)
    relative = i.inverse_depth_sigma[at_i] / i.inverse_depth[at_i]
    surface = pair.j.surface
    uv, expected = j.uv[at_j[good]], 1.0 / z[good]
    return depth_shift(j.size, surface.uv, 1.0 / surface.z, uv, expected, relative[good])


def _near(view: PreparedView, points: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Which points are not far behind what the view mostly sees: a stereo camera hardly measures
    them, and on a horizon things often look like others of another size.
    """
    return view.observed.inverse_depth[points] * view.median_depth_m > DIAGNOSTICS.far
