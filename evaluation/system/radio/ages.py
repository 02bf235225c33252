"""How old poses are over a time, and what the views took that they are of."""

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RobotPose
from fleetpose.protocol.transport import Link, Sample, wait_until

LOOKS_PER_S = 10.0
_SENT = re.compile(
    r"^(?P<at>\S+Z) INFO \S+ view name=(?P<name>\S+) salient=(?P<salient>\d+) bytes=(?P<bytes>\d+) "
    r".*put_ms=(?P<put_ms>\S+)$",
    re.MULTILINE,
)


@dataclass(frozen=True)
class Look:
    """What is known at a moment: the age of the newest pose of each robot that has one, from when
    its view was taken, and how many are located by a pose that holds.
    """

    ages_s: tuple[float, ...]
    located: int


@dataclass(frozen=True)
class SentView:
    """A view that a robot has put.

    Attributes:
        put_s: wall clock.
        salient: points in it.
    """

    name: str
    put_s: float
    bytes: int
    salient: int


def sent_views(log: str) -> list[SentView]:
    """The views that an agent's log tells of."""
    return [
        SentView(
            found["name"],
            datetime.fromisoformat(found["at"]).timestamp() - float(found["put_ms"]) / 1000,
            int(found["bytes"]),
            int(found["salient"]),
        )
        for found in _SENT.finditer(log)
    ]


class Ages:
    """Listens to poses, and looks at the newest ones.

    Args:
        link, keys: of the session to use; it must outlive this.
        robots: all of them.

    Attributes:
        first_s: by view, when its pose first came, wall clock.
    """

    def __init__(self, link: Link, keys: Keys, robots: Sequence[str]) -> None:
        self._robots = tuple(robots)
        self._newest: dict[str, RobotPose] = {}
        self.first_s: dict[str, float] = {}
        self._arrived: list[tuple[float, float]] = []
        link.on_latched(keys.poses, self._store)

    def look(self) -> Look:
        """What is known now."""
        now_ns = time.time_ns()
        newest = [self._newest[robot] for robot in self._robots if robot in self._newest]
        return Look(
            tuple((now_ns - pose.stamp_ns) * 1e-9 for pose in newest),
            sum(pose.located and pose.valid_until_ns > now_ns for pose in newest),
        )

    def on_arrival_s(self, since_s: float) -> list[float]:
        """How old the first pose of each view was when it came, after a wall clock's time."""
        return [age_s for at_s, age_s in self._arrived if at_s >= since_s]

    def all_located(self) -> bool:
        """Whether every robot is."""
        return self.look().located == len(self._robots)

    def all_newer(self, stamp_ns: int) -> bool:
        """Whether the pose of every robot is of a later moment."""
        newest = list(self._newest.values())
        return len(newest) == len(self._robots) and min(p.stamp_ns for p in newest) > stamp_ns

    def watch(self, seconds: float, check: Callable[[], None]) -> list[Look]:
        """Looks ten times a second for so long; `check` is called each time and may raise."""
        start_s, looks = time.monotonic(), []
        for number in range(1, int(seconds * LOOKS_PER_S) + 1):
            end_s = start_s + number / LOOKS_PER_S
            wait_until(lambda end_s=end_s: time.monotonic() >= end_s, 2.0)
            check()
            looks.append(self.look())
        return looks

    def _store(self, sample: Sample) -> None:
        try:
            pose = unpack(RobotPose, sample.payload, sample.encoding)
        except CodecError:
            return
        now_s, view = time.time(), str(pose.view)
        if view not in self.first_s:
            self.first_s[view] = now_s
            self._arrived.append((now_s, now_s - 1e-9 * pose.stamp_ns))
        self._newest[pose.robot] = pose
