"""A start from matched 3D points with many wrong matches: KISS-Matcher's pruning and solver, then a
rigid fit.
"""

import kiss_matcher
import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.dlt import rigid_unchecked
from fleetpose.pose_server.geometry.se3 import make_pose, transform

Floats = npt.NDArray[np.floating]


def solve(
    p_i: Floats, p_j: Floats, noise_bound: float
) -> tuple[Floats, npt.NDArray[np.bool_]] | None:
    """T_i_j from matched points (M, 3) in units of the scene's depth, and which matches agree; None
    if fewer than five do.

    KISS-Matcher (Lim et al. 2025) refuses small resolutions, hence the unit.
    """
    config = kiss_matcher.KISSMatcherConfig(noise_bound)
    found = kiss_matcher.KISSMatcher(config).prune_and_solve(
        np.ascontiguousarray(p_j, np.float32), np.ascontiguousarray(p_i, np.float32)
    )
    T = make_pose(np.asarray(found.rotation, np.float64), np.asarray(found.translation, np.float64))
    agrees = _distance(T, p_i, p_j) < 1.5 * noise_bound
    if agrees.sum() < 5:
        return None
    T = rigid_unchecked(p_i[agrees], p_j[agrees])
    agrees = _distance(T, p_i, p_j) < 3 * noise_bound
    return (T, agrees) if agrees.sum() >= 5 else None


def _distance(T_i_j: Floats, p_i: Floats, p_j: Floats) -> Floats:
    return np.linalg.norm(transform(T_i_j, p_j) - p_i, axis=1)
