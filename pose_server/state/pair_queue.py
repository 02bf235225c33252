"""The pairs of robots that wait to be aligned."""

from collections import deque
from dataclasses import dataclass, field

from fleetpose.pose_server.scheduling.settings import Line
from fleetpose.pose_server.scheduling.weighted_round_robin import WeightedRoundRobin
from fleetpose.pose_server.state.pairs import ViewPair
from fleetpose.protocol.keys import RobotPair
from fleetpose.protocol.messages import ViewName

SHARES: dict[Line, float] = {"joining": 8.0, "unlikely": 1.0, "sharpening": 2.0}


_MOST_TO_COMPARE = 20_000


@dataclass
class PairQueue:
    """What waits to be aligned between robots.

    Attributes:
        fresh: keyframes that were laid beside no others yet.
        to_compare: pairs of views whose looks are still to be compared, the newest last.
        lines: pairs of robots that wait, by kind.
        picked: why the last pair was picked, in words.
        max_wait_s: the longest that any pair has waited for its turn.
        max_wait_share: the same in picks, as a share of what the weights allow at most.
    """

    fresh: dict[ViewName, None] = field(default_factory=dict)
    to_compare: deque[ViewPair] = field(default_factory=lambda: deque(maxlen=_MOST_TO_COMPARE))
    lines: dict[Line, WeightedRoundRobin[RobotPair]] = field(
        default_factory=lambda: {line: WeightedRoundRobin() for line in SHARES}
    )
    picked: str = ""
    max_wait_s: float = 0.0
    max_wait_share: float = 0.0
    kinds: WeightedRoundRobin[Line] = field(default_factory=WeightedRoundRobin)
    roots: frozenset[ViewName] = frozenset()

    @property
    def waiting(self) -> int:
        """Pairs of robots in all lines."""
        return sum(map(len, self.lines.values()))
