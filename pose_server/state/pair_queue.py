"""The pairs of robots that wait to be aligned."""

from collections import deque
from collections.abc import Container
from dataclasses import dataclass, field
from itertools import islice

from fleetpose.pose_server.scheduling.settings import Line
from fleetpose.pose_server.scheduling.weighted_round_robin import Pick, WeightedRoundRobin
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

    def note_keyframe(self, view: ViewName) -> None:
        """A keyframe is to be laid beside the others."""
        self.fresh[view] = None

    def take_fresh(
        self, kept: Container[ViewName], solved: Container[ViewName], most: int
    ) -> list[ViewName]:
        """Takes so many keyframes that the solution knows by now; those that are not kept are left
        out.
        """
        self.fresh = {view: None for view in self.fresh if view in kept}
        taken = list(islice((view for view in self.fresh if view in solved), most))
        for view in taken:
            del self.fresh[view]
        return taken

    def any_fresh(self, solved: Container[ViewName]) -> bool:
        """Whether keyframes are left that the solution knows."""
        return any(view in solved for view in self.fresh)

    def see_components(self, roots: frozenset[ViewName]) -> bool:
        """Which components there are by their roots; whether others than before."""
        changed = roots != self.roots
        self.roots = roots
        return changed

    def compare_later(self, a: ViewName, b: ViewName) -> None:
        """The looks of two views are to be compared."""
        self.to_compare.append((a, b))

    def next_to_compare(self) -> ViewPair | None:
        """Takes the newest pair of views whose looks are to be compared."""
        return self.to_compare.pop() if self.to_compare else None

    def note_pick(self, chosen: Pick[RobotPair], why: str) -> None:
        """A pair was picked, for a reason."""
        self.picked = (
            f"{chosen.key[0]} - {chosen.key[1]}: {why}; waited {chosen.waited_s:.1f} s; "
            f"weight {chosen.weight:.2g} of {chosen.total:.2g}"
        )
        self.max_wait_s = max(self.max_wait_s, chosen.waited_s)
        share = chosen.waited_picks / chosen.most_picks
        self.max_wait_share = max(self.max_wait_share, share)
