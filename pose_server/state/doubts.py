"""Why robots are not believed."""

from collections.abc import Collection
from dataclasses import dataclass, field, replace
from typing import Literal

from fleetpose.pose_server.frontend.tracks import KeyframeRelativePose
from fleetpose.pose_server.state.odometry import Moment
from fleetpose.protocol.messages import ViewName

Kind = Literal["frozen", "still", "lost", "carried"]


@dataclass(frozen=True)
class Doubt:
    """Why a robot's pose is not believed.

    Attributes:
        kind: of alarm.
        text: the alarm's.
        since: the view with which it began.
    """

    kind: Kind
    text: str
    since: ViewName


@dataclass(frozen=True)
class Standstill:
    """Where a robot was believed to be last, before its odometry drove on without its pixels.

    Attributes:
        at: the last view that was believed.
        moment: the odometry of that view.
        since_s: when the first view came that contradicts, by the server's monotonic clock.
    """

    at: KeyframeRelativePose
    moment: Moment
    since_s: float


@dataclass
class Doubts:
    """What contradicts what, by robot.

    Attributes:
        standing: why robots are not believed now.
        standstills: robots whose odometry drives on without their pixels.
    """

    standing: dict[str, Doubt] = field(default_factory=dict)
    standstills: dict[str, Standstill] = field(default_factory=dict)

    def doubt(self, robot: str, doubt: Doubt) -> bool:
        """A robot is not believed; whether that is new: of the same kind only the words change."""
        known = self.standing.get(robot)
        if known is not None and known.kind == doubt.kind:
            self.standing[robot] = replace(known, text=doubt.text)
            return False
        self.standing[robot] = doubt
        return True

    def believe(self, robot: str, kinds: Collection[Kind]) -> bool:
        """Ends a doubt of one of these kinds; whether there was one."""
        known = self.standing.get(robot)
        if known is None or known.kind not in kinds:
            return False
        del self.standing[robot]
        return True

    def stop(self, robot: str, standstill: Standstill) -> None:
        """A robot's odometry drives on without its pixels."""
        self.standstills[robot] = standstill

    def move(self, robot: str) -> None:
        """Pixels and odometry of a robot agree again."""
        del self.standstills[robot]
