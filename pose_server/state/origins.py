"""Which origins the fleet has had."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.messages import ViewName


@dataclass
class Anchoring:
    """Which origins the fleet has had, and whether it waits for one.

    Attributes:
        asked: the robot that is to be the anchor by the settings.
        origins: earlier ones.
        left_s: since when no robot sees the origin's part of the map while some see each other.
        waits_s: since when robots are there but not the one that is to be the anchor.
        missing: what is said of an anchor that nobody has seen; empty if there is nothing to say.
        levels: R_fleet_robot (3, 3) of the origins at which the frame was turned upright.
    """

    asked: str | None = None
    origins: list[ViewName] = field(default_factory=list)
    left_s: float | None = None
    waits_s: float | None = None
    missing: str = ""
    levels: dict[ViewName, npt.NDArray[np.float64]] = field(default_factory=dict)

    def has_left(self, now_s: float, patience_s: float) -> bool:
        """No robot sees the origin while some see each other; whether that has been so for long."""
        self.left_s = now_s if self.left_s is None else self.left_s
        if now_s - self.left_s < patience_s:
            return False
        self.left_s = None
        return True

    def is_seen(self) -> None:
        """The origin is seen, or nobody sees another robot."""
        self.left_s = None

    def waits(self, now_s: float) -> float:
        """The anchor is not there although others are; for how many seconds."""
        self.waits_s = now_s if self.waits_s is None else self.waits_s
        return now_s - self.waits_s

    def is_there(self) -> None:
        """The anchor is there, or nobody is."""
        self.waits_s, self.missing = None, ""

    def miss(self, text: str) -> None:
        """What is said of an anchor that nobody has seen."""
        self.missing = text

    def move(self, left: ViewName, to: ViewName) -> None:
        """The origin is elsewhere from now on."""
        self.origins = [view for view in (*self.origins, left) if view != to]

    def set_level(self, origin: ViewName, R_fleet_robot: npt.NDArray[np.float64]) -> None:
        """The frame of an origin is turned so from now on."""
        self.levels[origin] = R_fleet_robot

    def forget(self, view: ViewName) -> None:
        """A keyframe is none any more, and no origin."""
        self.levels.pop(view, None)
