"""What an alignment tells besides the pose: whether the depths of two robots' views fit each other,
what moves in two views of one robot, and which points an operator might confirm.
"""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pose_server.calibration.compare import DepthErrors, compare_depths
from pose_server.pairs.judging import PairResult
from pose_server.pairs.moving import moving_masks
from pose_server.pairs.pair import Pair
from pose_server.pairs.suggesting import suggested
from pose_server.pairs.views import PreparedView

_FAR = 0.5  # median depth over depth


def with_byproducts(pair: Pair, result: PairResult) -> PairResult:
    """The result with what else the two views tell."""
    if pair.i.name.robot == pair.j.name.robot:
        return replace(result, moving=moving_masks(pair, result))
    return with_suggestions(pair, replace(result, depths=depths_of(pair, result)))


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


def _near(view: PreparedView, points: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    """Which points are not far behind what the view mostly sees: a stereo camera hardly measures
    them, and on a horizon things often look like others of another size.
    """
    return view.observed.inverse_depth[points] * view.median_depth_m > _FAR
