"""Which robot's clock is off, by when its views arrive.

A view arrives after it was taken, by milliseconds or, on a busy machine, by seconds. Of several
views the quickest says how far the robot's clock is ahead of the server's, or nearly so: no view
comes before it was taken. Stamps of two robots are never compared.
A robot that plays a recording says so: its stamps are of another time, and tell nothing.
"""

import statistics
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

KEPT_VIEWS = 10
LEAST_KEPT = 4
MOST_RECORDED = 1000  # robots that are known to play recordings
LEAST_AHEAD_S = 0.5
LEAST_BEHIND_S = 2.5  # a clock that is behind looks like a robot whose views are late,
STEADY_SHARE = 0.3  # but by much the same every time


@dataclass
class Clocks:
    """By how much the newest views of each robot's present life seemed to come before they were
    taken, seconds: negative as a rule.
    """

    _early_s: dict[str, tuple[str, deque[float]]] = field(default_factory=dict)
    _recorded: dict[str, str] = field(default_factory=dict)  # lives of robots that play recordings

    def note_recorded(self, robot: str, epoch: str, recorded: bool) -> None:
        """A robot has said whether its stamps are those of a recording. It may say so before it is
        known to be there.
        """
        self._recorded.pop(robot, None)
        if recorded:
            self._recorded[robot] = epoch
            self.forget(robot)
        while len(self._recorded) > MOST_RECORDED:
            self._recorded.pop(next(iter(self._recorded)))

    def note(self, robot: str, epoch: str, early_s: float) -> None:
        """A view has arrived; early_s is its stamp minus the server's clock."""
        if self._recorded.get(robot) == epoch:
            return
        life, kept = self._early_s.get(robot, (epoch, deque[float](maxlen=KEPT_VIEWS)))
        if life != epoch:
            kept = deque[float](maxlen=KEPT_VIEWS)
        kept.append(early_s)
        self._early_s[robot] = epoch, kept

    def wrong(self) -> Iterator[tuple[str, float]]:
        """Robots whose clock is off, and by how many seconds it is ahead."""
        ahead_s = {r: max(kept) for r, (_, kept) in self._early_s.items() if len(kept) > LEAST_KEPT}
        # on a machine that has too much to do all views are late
        usual_s = min(statistics.median(ahead_s.values()), 0.0) if len(ahead_s) > 2 else 0.0
        for robot, early_s in sorted(ahead_s.items()):
            spread_s = early_s - statistics.median(self._early_s[robot][1])
            kept = len(self._early_s[robot][1])  # while all start up, the first few are late
            late = kept == KEPT_VIEWS and early_s < usual_s - LEAST_BEHIND_S
            behind = late and spread_s < -STEADY_SHARE * early_s
            if early_s > LEAST_AHEAD_S or behind:
                yield robot, early_s

    def forget(self, robot: str) -> None:
        """A robot's clock was set: what was seen of it before tells nothing."""
        self._early_s.pop(robot, None)

    def keep_only(self, robots: Collection[str]) -> None:
        """Drops robots that are gone."""
        self._early_s = {r: kept for r, kept in self._early_s.items() if r in robots}
