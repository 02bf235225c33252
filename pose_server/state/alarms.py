"""What is wrong with robots, as it stands now, and what routers deny."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from fleetpose.protocol.messages import Alarm, Denial, Denials

MAX_ROUTERS = 16
MAX_TOLD = 2000
MOST_DENIALS = 50
MOST_NEWS = 5  # events at a time: who tries everything must not displace what else happened


@dataclass
class Alarms:
    """Alarms about calibrations and clocks.

    Attributes:
        standing: those of now.
        distortions: those of them that say that a robot's depths bend.
    """

    standing: tuple[Alarm, ...] = ()
    distortions: tuple[Alarm, ...] = ()
    _told: set[tuple[str, str]] = field(default_factory=set)

    def keep_distortions(self, alarms: Sequence[Alarm]) -> None:
        """What the newest comparisons of depths say."""
        self.distortions = tuple(alarms)

    def renew(self, alarms: Sequence[Alarm]) -> list[Alarm]:
        """These stand now; of them, those that were no event yet."""
        self.standing = tuple(alarms)
        new = [alarm for alarm in alarms if (alarm.robot, alarm.kind) not in self._told]
        self._told.update((alarm.robot, alarm.kind) for alarm in new)
        return new

    def forget(self, robot: str) -> None:
        """A robot has another calibration: what was told of it may be told again."""
        self._told = {of for of in self._told if of[0] != robot}


@dataclass
class RouterDenials:
    """The newest word of each router."""

    _of: dict[str, Denials] = field(default_factory=dict)
    _told: set[tuple[str, str]] = field(default_factory=set)

    def note(self, denials: Denials) -> list[str]:
        """Takes a router's word; what is new in it, in words: each name once for each router."""
        router = denials.router
        if router not in self._of and len(self._of) >= MAX_ROUTERS:
            return []
        self._of[router] = denials
        said = {
            one.who: f"router {router} denies {one.who}: {one.what} on {one.key}"
            for one in reversed(denials.denied)
        }
        said |= {
            cause: f"router {router} turns away who comes: {cause}" for cause in denials.refused
        }
        news = [what for what in said if (router, what) not in self._told][:MOST_NEWS]
        if len(self._told) < MAX_TOLD:
            self._told.update((router, what) for what in news)
            return [said[what] for what in news]
        return []

    @property
    def denied(self) -> tuple[Denial, ...]:
        """Of all routers, the most frequent first."""
        every = [one for denials in self._of.values() for one in denials.denied]
        return tuple(sorted(every, key=lambda one: -one.n)[:MOST_DENIALS])

    @property
    def refused(self) -> dict[str, int]:
        """Handshakes that failed, of all routers, by cause."""
        counts: Counter[str] = Counter()
        for denials in self._of.values():
            counts.update(denials.refused)
        return dict(counts)

    def of(self, who: str, key: str) -> int:
        """How often somebody was denied to put under a key, whatever generation his certificate
        is of.
        """
        return sum(
            one.n
            for denials in self._of.values()
            for one in denials.denied
            if one.who.partition("#")[0] == who and one.key == key and one.what.startswith("Put")
        )
