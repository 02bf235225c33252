"""What of the world a set of matches rests on, told compactly: where it is and how far it reaches.

Two views of one facade fit two views of its copy just as well, again and again. That is one
observation told twice. So it counts which part of the world two observations rest on.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import transform
from fleetpose.pose_server.tuned import in_use

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class StructureSettings:
    """What this module goes by; where it is from: `pose_server.tuned`."""

    reach_sigmas: float = 2.0  # of a set of points to each side, along any direction
    least_share: float = 0.001  # of the distance: thinner than that no set of measured points is


STRUCTURE = in_use("structure", StructureSettings())


@dataclass(frozen=True, eq=False)
class Structure:
    """Points of one frame, by their middle (3,) and covariance (3, 3), metres."""

    centre: Floats
    spread: Floats

    @classmethod
    def of(cls, points: Floats) -> "Structure":
        """Of points (N, 3); what is nan is not known. Of none it is nowhere, apart from nothing."""
        points = points[np.isfinite(points).all(axis=1)]
        if len(points) == 0:
            return cls(np.full(3, np.nan), np.eye(3))
        centre = points.mean(axis=0)
        off = points - centre
        thin = STRUCTURE.least_share * float(np.linalg.norm(centre))
        return cls(centre, off.T @ off / len(points) + thin**2 * np.eye(3))

    def seen_from(self, T_other_here: Floats) -> "Structure":
        """The same in another frame."""
        R = T_other_here[:3, :3]
        return Structure(transform(T_other_here, self.centre[None])[0], R @ self.spread @ R.T)

    def apart(self, other: "Structure") -> bool:
        """Whether two sets lie side by side: along the direction that tells them apart best
        (Fisher's) each ends before the other begins.
        """
        return bool(self.apart_from(other.centre[None], other.spread[None])[0])

    def apart_from(self, centres: Floats, spreads: Floats) -> npt.NDArray[np.bool_]:
        """The same of many others (N, 3), (N, 3, 3); nan is apart from nothing."""
        between = centres - self.centre
        across = np.linalg.solve(self.spread + spreads, between[:, :, None])[:, :, 0]
        own = np.sqrt(np.einsum("ni,ij,nj->n", across, self.spread, across))
        others = np.sqrt(np.einsum("ni,nij,nj->n", across, spreads, across))
        gap = np.abs((across * between).sum(axis=1))
        return (gap > STRUCTURE.reach_sigmas * (own + others)) & (gap > 0.0)
