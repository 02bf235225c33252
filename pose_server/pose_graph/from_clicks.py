"""A relative pose from the operator's clicks alone, when three or more of them determine it."""

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.consensus import consensus
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.noise import chi2_limit
from fleetpose.pose_server.geometry.point_pairs import PointPairs

Floats = npt.NDArray[np.floating]

_MAX_ROTATION_SIGMA_RAD = 0.35  # beyond it a linearised covariance means nothing


def pose_from_clicks(pairs: PointPairs, inlier_probability: float) -> tuple[Floats, Floats]:
    """T_a_b (4, 4) and its covariance (6, 6) from three or more point pairs, of which most agree.

    Raises:
        DegenerateGeometryError: fewer than three, on a line, contradictory, or too weak to give an
            orientation.
    """
    agreed = consensus(pairs, chi2_limit(1 - inlier_probability, 3))
    if agreed.contradiction:
        raise DegenerateGeometryError(agreed.contradiction)
    sigma = float(np.sqrt(max(np.linalg.eigvalsh(agreed.covariance[:3, :3])[-1], 0.0)))
    if not sigma < _MAX_ROTATION_SIGMA_RAD:
        raise DegenerateGeometryError(
            f"{int(agreed.inliers.sum())} clicks leave an orientation error of "
            f"{np.degrees(sigma):.0f} deg, need below {np.degrees(_MAX_ROTATION_SIGMA_RAD):.0f} deg"
        )
    return agreed.T_a_b, agreed.covariance
