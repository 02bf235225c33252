"""Which points of a view move: together with those around them, as wrong matches do not."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]
Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class MotionSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    around: int = 8  # matches that tell what happens around one
    alike: int = 5  # of these, itself included, that must be shifted alike
    alike_px: float = 2.0  # how far shifts that are alike may differ, px
    alike_share: float = 0.25  # or share of the shift


MOTION = in_use("motion", MotionSettings())


@dataclass(frozen=True)
class Mask:
    """Where something moves in a view: around which pixels (N, 2), how far, px; and pixels (M, 2)
    that stand still.
    """

    moving: Floats
    still: Floats
    reach_px: float

    def hits(self, uv: Floats) -> Bools:
        """Which pixels (K, 2) lie within reach of moving matches and nearer to them than to any
        still one.
        """
        moving = cKDTree(self.moving).query(uv, distance_upper_bound=self.reach_px)[0]
        return np.isfinite(moving) & (moving < cKDTree(self.still).query(uv)[0])


def moves_together(uv: Floats, shift: Floats, off: Bools) -> Bools:
    """Which matches (M,) move.

    Args:
        uv: (M, 2) where they are, px.
        shift: (M, 2) how far from where they would be if they stood still, px.
        off: (M,) which are clearly not there.
    """
    if len(uv) < MOTION.around:
        return np.zeros(len(uv), bool)
    near = cKDTree(uv).query(uv, k=MOTION.around)[1]
    differ = np.linalg.norm(shift[near] - shift[:, None], axis=2)
    allowed = np.maximum(MOTION.alike_px, MOTION.alike_share * np.linalg.norm(shift, axis=1))
    alike = off[near] & (differ < allowed[:, None])
    return off & (alike.sum(axis=1) >= MOTION.alike)


def some_together(uv: Floats, shift: Floats, reach_px: float, least: int) -> bool:
    """Whether so many matches near each other are shifted alike: cheap, and no proof.

    Args:
        uv: (M, 2) where matches are that are not where they were, px.
        shift: (M, 2) px.
        reach_px: how near.
    """
    apart = np.linalg.norm(uv[:, None] - uv, axis=2)
    differ = np.linalg.norm(shift[:, None] - shift, axis=2)
    allowed = np.maximum(MOTION.alike_px, 0.5 * MOTION.alike_share * np.linalg.norm(shift, axis=1))
    alike = (apart < reach_px) & (differ < allowed[:, None])
    places = np.unique(np.rint(uv), axis=0, return_inverse=True)[1].ravel()
    return any(len(set(places[row].tolist())) >= least for row in alike)
