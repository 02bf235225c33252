"""When messages were taken, and which of them belong together."""

import struct
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.bag import Recorded

T = TypeVar("T")

_AT = 4  # behind CDR's encapsulation, and behind the sequence number of ROS 1 alike
_WAITING = 200  # of a stream; more come only where the other one has ended


def header_ns(message: Recorded) -> int:
    """UTC of its header, ns, of a message that begins with one: images, infos, clouds, odometry.
    The message itself is not read.

    Raises:
        CodecError: it is too short.
    """
    raw = message.raw
    big = message.kind.coding == "cdr" and len(raw) > 1 and not raw[1] & 1
    try:
        seconds, nanoseconds = struct.unpack_from(">iI" if big else "<iI", raw, _AT)
    except struct.error as error:
        raise CodecError(f"{message.topic}: a message of {len(raw)} bytes") from error
    return seconds * 10**9 + nanoseconds


def stamp_ns(stamped: Any) -> int:
    """UTC of a message's header, ns."""
    stamp = stamped.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


@dataclass(frozen=True)
class Moment(Generic[T]):
    """Items of one moment, one of each stream; the first one's stamp counts.

    Attributes:
        stamp_ns: of the first stream's item.
        items: in the order of the streams.
        skew_ns: how far the farthest of the others is from the first.
    """

    stamp_ns: int
    items: tuple[T, ...]
    skew_ns: int


@dataclass
class Pairing(Generic[T]):
    """Puts together what streams took at one moment: to each item of the first the nearest of every
    other, each once.

    Attributes:
        streams: how many.
        at_most_ns: items farther apart do not belong together.
        dropped: of the first stream, those without a partner.
        skews_ns: of the moments so far.
    """

    streams: int
    at_most_ns: int
    dropped: int = 0
    skews_ns: list[int] = field(default_factory=list)
    _waiting: list[deque[tuple[int, T]]] = field(init=False)

    def __post_init__(self) -> None:
        self._waiting = [deque(maxlen=_WAITING) for _ in range(self.streams)]

    def add(self, stream: int, stamp_ns: int, item: T) -> Iterator[Moment[T]]:
        """Takes an item; gives the moments that are complete with it."""
        if len(self._waiting[stream]) == _WAITING and not stream:
            self.dropped += 1
        self._waiting[stream].append((stamp_ns, item))
        first, *others = self._waiting
        while first and all(_reaches(other, first[0][0]) for other in others):
            yield from self._take()

    def rest(self) -> Iterator[Moment[T]]:
        """The moments that are left when nothing more comes."""
        while self._waiting[0]:
            yield from self._take()

    def _take(self) -> Iterator[Moment[T]]:
        """The oldest of the first stream with its partners, if it has them."""
        first, *others = self._waiting
        stamp_ns, item = first.popleft()
        nearest = [_nearest(other, stamp_ns) for other in others]
        skew_ns = max((_apart(other, k, stamp_ns) for other, k in zip(others, nearest)), default=0)
        if skew_ns > self.at_most_ns:
            self.dropped += 1
            return
        partners = [_taken(other, k) for other, k in zip(others, nearest)]
        self.skews_ns.append(skew_ns)
        yield Moment(stamp_ns, (item, *partners), skew_ns)


def _reaches(waiting: Sequence[tuple[int, T]], stamp_ns: int) -> bool:
    return bool(waiting) and waiting[-1][0] >= stamp_ns


def _nearest(waiting: Sequence[tuple[int, T]], stamp_ns: int) -> int:
    return min(range(len(waiting)), key=lambda k: abs(waiting[k][0] - stamp_ns), default=-1)


def _apart(waiting: Sequence[tuple[int, T]], k: int, stamp_ns: int) -> int:
    return abs(waiting[k][0] - stamp_ns) if k >= 0 else 2**63


def _taken(waiting: deque[tuple[int, T]], k: int) -> T:
    for _ in range(k):
        waiting.popleft()
    return waiting.popleft()[1]
