"""Which points of a pair an operator might confirm: matches that nothing vouches for yet."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.refine import NoiseScale
from fleetpose.pose_server.registration.pair import Pair
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SuggestedPointsSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    most: int = 12  # points that are suggested for a pair
    considered: int = 400  # matches by descriptor, the most similar first
    noise: NoiseScale = NoiseScale(1.5, 1.5)  # a pose that is about right is enough
    apart: float = 0.1  # share of the image's height: nearer points tell little more


SUGGESTED_POINTS = in_use("suggested_points", SuggestedPointsSettings())


def suggested(pair: Pair, T_i_j: Floats | None) -> Floats:
    """Pixels (M, 4) of both views, u_i v_i u_j v_j, at most 12: of the matches by descriptor those
    that agree with the best pose that was found, then the others, each the most similar first.
    Those near to a better one are left out, so that three of them make a triangle.
    """
    matches = pair.ratio[: SUGGESTED_POINTS.considered]
    agrees = _agreeing(pair, matches, T_i_j)
    matches = np.concatenate((matches[agrees], matches[~agrees]))
    uv_i = pair.i.observed.uv[matches[:, 0]]
    uv_j = pair.j.observed.uv[matches[:, 1]]
    height = min(pair.i.observed.size[1], pair.j.observed.size[1])
    chosen = apart_in_both(uv_i, uv_j, height)
    return np.column_stack((uv_i[chosen], uv_j[chosen]))


def _agreeing(pair: Pair, matches: Indices, T_i_j: Floats | None) -> npt.NDArray[np.bool_]:
    if T_i_j is None or len(matches) < 3:
        return np.zeros(len(matches), bool)
    try:
        return pair.scored(T_i_j, matches, SUGGESTED_POINTS.noise).inliers
    except DegenerateGeometryError:
        return np.zeros(len(matches), bool)


def apart_in_both(uv_i: Floats, uv_j: Floats, height_px: float) -> list[int]:
    """The first pixels (N, 2) that are far from all chosen before them in both views, for images of
    that height; 12 at most.
    """
    least_px = SUGGESTED_POINTS.apart * height_px
    chosen: list[int] = []
    for k in range(len(uv_i)):
        near = min(
            (
                min(np.linalg.norm(uv_i[k] - uv_i[c]), np.linalg.norm(uv_j[k] - uv_j[c]))
                for c in chosen
            ),
            default=np.inf,
        )
        if near >= least_px:
            chosen.append(k)
        if len(chosen) == SUGGESTED_POINTS.most:
            break
    return chosen
