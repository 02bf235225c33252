"""What a session does not know but keeps account of: changes, events, and what was dropped.

Any thread may feed a session and any thread may command it. Screens poll `revisions()` at their own
rate, so that a fast feed cannot flood a slow terminal; other threads sleep in `wait_change`.
"""

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import Literal

from fleetpose.protocol.drops import Drops

Topic = (
    Literal["fleet", "poses", "alignment", "correspondences", "pictures"]
    | Literal["selection", "updates", "events", "status", "settings", "drops", "depths", "others"]
)


class Changes:
    """Numbers changes by topic and wakes those who wait for one.

    Args:
        clock: monotonic seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.events: deque[str] = deque(maxlen=50)
        self._events_s: deque[float] = deque(maxlen=50)
        self.drops = Drops()
        self._events_said = 0
        self._revisions: Counter[str] = Counter()
        self._changed = threading.Condition(threading.RLock())

    def revisions(self) -> dict[str, int]:
        """A number per topic that grows with every change; a topic without is at 0."""
        with self._changed:
            return dict(self._revisions)

    def wait_change(
        self, seen: dict[str, int], topics: tuple[Topic, ...], timeout_s: float
    ) -> bool:
        """Sleeps until one of the topics is newer than seen; whether it is."""
        with self._changed:
            return self._changed.wait_for(
                lambda: any(self._revisions[t] != seen.get(t, 0) for t in topics), timeout_s
            )

    def events_since(self, count: int) -> tuple[list[str], int]:
        """Events after the first `count` ever, as far as they are kept, and how many there were."""
        with self._changed:
            fresh = min(self._events_said - count, len(self.events))
            return list(self.events)[len(self.events) - fresh :], self._events_said

    def timed_events(self) -> list[tuple[float, str]]:
        """What happened, the newest first, and how many seconds ago."""
        with self._changed:
            now = self.clock()
            both = zip(self._events_s, self.events, strict=True)
            return [(now - at, text) for at, text in both][::-1]

    def drop(self, key: str, error: Exception) -> None:
        """Counts something that arrived under a key and could not be used."""
        self.drops.note(key, error)
        with self._changed:
            self._bump("drops")

    def _say(self, *sentences: str) -> None:
        self.events.extend(sentences)
        self._events_s.extend([self.clock()] * len(sentences))
        self._events_said += len(sentences)
        if sentences:
            self._bump("events")

    def _bump(self, *topics: Topic) -> None:
        for topic in topics:
            self._revisions[topic] += 1
        self._changed.notify_all()
