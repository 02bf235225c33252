"""Does one of two cameras give mirrored images? Then nothing aligns but what is its own mirror
image, and that from behind.

Some drivers flip images, and their depths with them. SIFT tells: the descriptor of a mirrored
patch is the patch's own with its rows of cells turned over and its directions reversed. So one view
is mirrored back on the server, and if that makes them fit, the reason is named.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.matching import ratio_matches
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.features.triangles import poses_by_triangles
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.tuned import in_use

Descriptors = npt.NDArray[np.float32]

_CELLS, _DIRECTIONS = 4, 8  # cited: of a SIFT descriptor (Lowe 2004)


@dataclass(frozen=True)
class MirroredSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    least_agreeing: int = 25  # matches that must agree once one view is mirrored
    times_more: float = 2.0  # and over those that agree as the views are


MIRRORED = in_use("mirrored", MirroredSettings())


REASON = "the views fit if one of them is mirrored: does a camera or its driver flip images?"


def is_mirrored(pair: Pair, agreeing: int) -> bool:
    """Whether two views fit each other once one of them is mirrored.

    Args:
        pair: the views.
        agreeing: matches by descriptor alone that agree with what was found as they are.
    """
    i, j = pair.i, pair.j
    if i.descriptors.shape[1] != _CELLS * _CELLS * _DIRECTIONS:
        return False
    lifted_i, lifted_j = i.observed.lifted, j.observed.lifted
    turned = mirrored_descriptors(j.descriptors[lifted_j])
    matches, cosines = ratio_matches(i.descriptors[lifted_i], turned, pair.ratio_limit)
    needed = max(MIRRORED.least_agreeing, MIRRORED.times_more * agreeing)
    if len(matches) < needed:
        return False
    matches = matches[np.argsort(-cosines, kind="stable")]
    matches = np.column_stack((lifted_i[matches[:, 0]], lifted_j[matches[:, 1]]))
    found = poses_by_triangles(i.observed, mirrored(j.observed), matches, pair.depth_m)
    return bool(found) and len(found[0][1]) >= needed


def mirrored_descriptors(descriptors: Descriptors) -> Descriptors:
    """SIFT descriptors (N, 128) of the same points in the mirrored image."""
    cells = descriptors.reshape(len(descriptors), _CELLS, _CELLS, _DIRECTIONS)
    reversed_ = (-np.arange(_DIRECTIONS)) % _DIRECTIONS
    return np.ascontiguousarray(cells[:, ::-1][..., reversed_].reshape(descriptors.shape))


def mirrored(observed: Observed) -> Observed:
    """The same points in the image mirrored left to right."""
    width = observed.size[0]
    K, uv = observed.K.copy(), observed.uv.copy()
    K[0, 2], uv[:, 0] = width - 1 - K[0, 2], width - 1 - uv[:, 0]
    return replace(observed, K=K, uv=uv)
