"""How much older a robot's depths are than its images, by its own views.

The depths of a view fit its image best some pixels aside (`calibration.shift`): by how far the
image moved in the meantime, less what is true of the keyframe that it is compared with. Both follow
the robot's motion, so that a robot that stands still or moves steadily tells nothing.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.calibration.depth_shift import DepthShift
from fleetpose.pose_server.calibration.findings import Estimate
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]

KEPT_VIEWS = 20
_TRIED_VIEWS = 5  # it takes the next view to know how fast a robot moved
LEAST_OFFSET_S = 0.04
_LEAST_MEASURED = 6
_SIGMAS = 5.0
_GEMAN_MCCLURE, _ROUNDS = 9.0, 10
_MAD_SIGMA = 1.4826


@dataclass
class TimeOffsets:
    """The newest shifts of each robot's views against its keyframes, and how fast their images
    moved, px/s, where that is known.
    """

    _shifts: dict[str, deque[tuple[ViewName, ViewName, DepthShift]]] = field(default_factory=dict)
    _flows: dict[ViewName, Floats] = field(default_factory=dict)

    def note(self, keyframe: ViewName, view: ViewName, shift: DepthShift) -> None:
        """Where a view's depths fit best by a keyframe."""
        kept = self._shifts.setdefault(view.robot, deque(maxlen=KEPT_VIEWS))
        kept.append((keyframe, view, shift))
        named = {name for shifts in self._shifts.values() for pair in shifts for name in pair[:2]}
        self._flows = {name: flow for name, flow in self._flows.items() if name in named}

    def forget(self, robot: str) -> None:
        """Drops what is known of a robot."""
        self._shifts.pop(robot, None)

    @property
    def robots(self) -> list[str]:
        """Of which anything is known."""
        return sorted(self._shifts)

    def without_flow(self, robot: str) -> set[ViewName]:
        """Of the newest views, those whose motion is still to be told."""
        newest = list(self._shifts.get(robot, ()))[-_TRIED_VIEWS:]
        names = {name for pair in newest for name in pair[:2]}
        return {name for name in names if name not in self._flows}

    def note_flow(self, view: ViewName, flow: Floats) -> None:
        """How fast the image moved when a view was taken, (2,) px/s."""
        self._flows[view] = flow

    def offset(self, robot: str) -> Estimate | None:
        """How much older the robot's depths are than its images, where that is clear."""
        rows = [
            (shift.shift_px, shift.sigma_px, self._flows[view] - self._flows[keyframe])
            for keyframe, view, shift in self._shifts.get(robot, ())
            if view in self._flows and keyframe in self._flows
        ]
        if len(rows) < _LEAST_MEASURED:
            return None
        shifts, sigmas, flows = (np.array(part) for part in zip(*rows, strict=True))
        return depth_time_offset(shifts, sigmas, flows)


def depth_time_offset(shifts: Floats, sigmas: Floats, flows: Floats) -> Estimate | None:
    """How much older depths are than images, seconds.

    Args:
        shifts: (M, 2) px, from a pixel to where its depth was found, with sigmas (M, 2).
        flows: (M, 2) px/s, how much faster the image moved than that of the keyframe.

    Returns:
        The offset where it is clearly not zero.
    """
    r, a = (shifts / sigmas).ravel(), (-flows / sigmas).ravel()
    information = float(a @ a)
    if information < 1e-6:
        return None
    value = float(a @ r) / information
    for _ in range(_ROUNDS):
        weight = 1.0 / (1.0 + (r - a * value) ** 2 / _GEMAN_MCCLURE) ** 2
        value = float((weight * a) @ r) / max(float((weight * a) @ a), 1e-6)
    excess = max(1.0, _MAD_SIGMA * float(np.median(np.abs(r - a * value))))
    estimate = Estimate(value, excess / float(np.sqrt(information)), len(shifts))
    clear = abs(value) > LEAST_OFFSET_S and estimate.significance > _SIGMAS
    return estimate if clear else None
