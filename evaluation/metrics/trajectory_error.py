"""Absolute trajectory error as papers count it: root mean square of the positions' distances to the
truth after the rigid motion, without scale, that fits best (Umeyama 1991; `evo_ape -a` prints the
same).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.metrics.scoring import aligned_errors_m

LEAST_POSES = 3
"""Fewer positions fit any truth."""
Positions = tuple[Floats, Floats]
"""(N, 3) true and estimated positions of one robot at the same moments, metres."""


@dataclass(frozen=True)
class TrajectoryError:
    """What is left after fitting.

    Attributes:
        joint_m: one fit for all robots: robots that are wrong relative to each other show in it.
        robots_m: a fit for each robot: its own drift alone.
    """

    joint_m: float | None
    robots_m: dict[str, float]

    @property
    def robots_mean_m(self) -> float | None:
        """Mean over the robots."""
        return float(np.mean(list(self.robots_m.values()))) if self.robots_m else None


def trajectory_error(robots: Mapping[str, Positions]) -> TrajectoryError:
    """The errors of robots whose estimates are in one frame; of too few poses there is none."""
    own = {name: _rms(*both) for name, both in robots.items() if len(both[0]) >= LEAST_POSES}
    together = [np.concatenate([both[k] for both in robots.values()]) for k in (0, 1) if robots]
    joint = _rms(*together) if together and len(together[0]) >= LEAST_POSES else None
    return TrajectoryError(joint, own)


def _rms(true: Floats, found: Floats) -> float:
    return float(np.sqrt(np.mean(aligned_errors_m(true, found) ** 2)))
