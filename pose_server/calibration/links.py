"""Which robot's link is too slow for its views, by what the robots tell of it with each of them."""

import statistics
from collections import deque
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

KEPT_VIEWS = 10
LEAST_KEPT = 4
SLOW_S = 1.0  # a view that takes longer on its way stands for no "now"


@dataclass(frozen=True)
class SlowLink:
    """What a robot tells of its link.

    Attributes:
        on_way_s: median of what its newest views took.
        share: of its salient points that it sends.
    """

    robot: str
    on_way_s: float
    share: float


@dataclass
class Links:
    """What the newest views of each robot's present life tell of their way."""

    _told: dict[str, tuple[str, deque[tuple[float, float]]]] = field(default_factory=dict)

    def note(self, robot: str, epoch: str, on_way_s: float, share: float) -> None:
        """A view has arrived: what the one before took, and the share of its points it has."""
        life, kept = self._told.get(robot, (epoch, deque[tuple[float, float]](maxlen=KEPT_VIEWS)))
        if life != epoch:
            kept = deque[tuple[float, float]](maxlen=KEPT_VIEWS)
        kept.append((on_way_s, share))
        self._told[robot] = epoch, kept

    def slow(self) -> Iterator[SlowLink]:
        """Robots whose views are late, or were made smaller for not to be."""
        for robot, (_, kept) in sorted(self._told.items()):
            on_way_s = statistics.median(took_s for took_s, _ in kept)
            share = kept[-1][1]
            if len(kept) > LEAST_KEPT and (on_way_s > SLOW_S or share < 1.0):
                yield SlowLink(robot, on_way_s, share)

    def keep_only(self, robots: Collection[str]) -> None:
        """Drops robots that are gone."""
        self._told = {robot: told for robot, told in self._told.items() if robot in robots}
