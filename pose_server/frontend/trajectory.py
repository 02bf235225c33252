"""All that a robot's track knows of where its views hang, also of views that are no longer kept: a
pose and a time are small.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.se3 import compose_covariance
from fleetpose.protocol.messages import Verdict, ViewName

Floats = npt.NDArray[np.floating]

FLEET_FOLLOWED = 100_000  # of all robots together: some 30 MB on disk, thrice that in memory
LEAST_FOLLOWED, MOST_FOLLOWED = 500, 20_000  # of a robot


@dataclass(frozen=True, eq=False)
class Followed:
    """A view that hangs on a keyframe, maybe itself.

    Attributes:
        stamp_ns: of the view, by its robot's clock.
        T_keyframe_view: (4, 4) of their cameras.
        covariance: (6, 6) of left perturbations; nan where it is not known any more.
    """

    view: ViewName
    stamp_ns: int
    keyframe: ViewName
    T_keyframe_view: Floats
    covariance: Floats
    verdict: Verdict


@dataclass
class Trajectory:
    """Where a robot's views hang, the oldest first."""

    views: dict[ViewName, Followed] = field(default_factory=dict)

    def note(self, followed: Followed, most: int = MOST_FOLLOWED) -> None:
        """A view hangs somewhere, or elsewhere than before; beyond so many the oldest are let go
        that are no keyframes.
        """
        self.views[followed.view] = followed
        if len(self.views) > most:
            spare = next((v for v, one in self.views.items() if one.keyframe != v), None)
            if spare is not None:
                del self.views[spare]

    def rehang(self, keyframe: ViewName, other: ViewName, T: Floats, covariance: Floats) -> None:
        """A keyframe is none any more: what hung on it hangs on another one.

        Args:
            T: T_other_keyframe (4, 4).
            covariance: (6, 6) of it.
        """
        for view, one in self.views.items():
            if one.keyframe == keyframe:
                self.views[view] = replace(
                    one,
                    keyframe=other,
                    T_keyframe_view=T @ one.T_keyframe_view,
                    covariance=compose_covariance(T, covariance, one.covariance),
                )

    def forget(self, keyframe: ViewName) -> None:
        """A keyframe is none any more, and nothing tells where it was."""
        self.views = {view: one for view, one in self.views.items() if one.keyframe != keyframe}

    def recall(self, followed: Mapping[ViewName, Followed]) -> None:
        """What is known of an earlier life of the server."""
        self.views = {**followed, **self.views}


def most_followed(robots: int) -> int:
    """Of how many views of each of so many robots this is kept."""
    return min(max(FLEET_FOLLOWED // max(robots, 1), LEAST_FOLLOWED), MOST_FOLLOWED)
