"""One radio channel that several stations share, as accounting of packets: no sockets, no clock.

Only one station sends at a time, in turns. A packet waits in its station's queue, takes the time
that its bits need on the air, and arrives after the delay unless it is lost. What is lost has still
taken its time.
"""

import heapq
import random
from collections import deque
from collections.abc import Hashable
from dataclasses import dataclass, field

from fleetpose.evaluation.options.field import RadioLink

QUEUE_S = 0.25
"""A station's queue holds what the channel carries in this time; more is dropped at its end. That
is the rule by which buffers are sized: rate times a usual round trip (Villamizar and Song 1994)."""
_LEAST_QUEUE_BYTES = 3000  # two whole packets, however slow the channel


@dataclass
class Account:
    """Of the packets that one station sent.

    Attributes:
        sent, bytes: on the air, lost ones included.
        lost: by chance, or while the link was down.
        full: dropped because the queue was.
    """

    sent: int = 0
    bytes: int = 0
    lost: int = 0
    full: int = 0


@dataclass
class _Station:
    """Packets that wait: (when it came, whom it is for, the packet)."""

    waiting: deque[tuple[float, Hashable, bytes]] = field(default_factory=deque)
    bytes: int = 0
    account: Account = field(default_factory=Account)


class Air:
    """The channel. All times are seconds of one monotonic clock.

    Args:
        link: rate, delay in each direction, and share of packets lost.
        seed: of the losses.
    """

    def __init__(self, link: RadioLink, seed: int) -> None:
        self._bytes_per_s = 1000 * link.rate_kbit / 8
        self._delay_s, self._loss = link.delay_ms / 1000, link.loss
        self._queue_bytes = max(QUEUE_S * self._bytes_per_s, _LEAST_QUEUE_BYTES)
        self._chance = random.Random(seed)
        self._stations: dict[Hashable, _Station] = {}
        self._turns: deque[Hashable] = deque()
        self._free_s = 0.0
        self._flying: list[tuple[float, int, Hashable, bytes]] = []
        self._count = 0
        self.down = False

    def accounts(self) -> dict[Hashable, Account]:
        """Of every station that has sent."""
        return {name: station.account for name, station in self._stations.items()}

    def offer(self, sender: Hashable, receiver: Hashable, packet: bytes, now_s: float) -> None:
        """A station wants to send a packet now."""
        self._serve(now_s)
        station = self._stations.get(sender)
        if station is None:
            station = self._stations[sender] = _Station()
            self._turns.append(sender)
        if station.bytes + len(packet) > self._queue_bytes:
            station.account.full += 1
            return
        station.waiting.append((now_s, receiver, packet))
        station.bytes += len(packet)

    def arrived(self, now_s: float) -> list[tuple[Hashable, bytes]]:
        """What has come through by now and was not given out before: receivers and packets."""
        self._serve(now_s)
        found = []
        while self._flying and self._flying[0][0] <= now_s:
            _, _, receiver, packet = heapq.heappop(self._flying)
            found.append((receiver, packet))
        return found

    def next_s(self) -> float | None:
        """When something will happen next; None if nothing is under way."""
        times = [self._flying[0][0]] if self._flying else []
        if any(station.waiting for station in self._stations.values()):
            times.append(self._free_s)
        return min(times, default=None)

    def _serve(self, now_s: float) -> None:
        """Puts on the air what has begun by now."""
        while heads := [s.waiting[0][0] for s in self._stations.values() if s.waiting]:
            start_s = max(self._free_s, min(heads))
            if start_s > now_s:
                return
            self._send(self._whose_turn(start_s), start_s)

    def _whose_turn(self, start_s: float) -> _Station:
        """The next station in turn whose first packet is there; the turn goes on behind it."""
        while True:
            name = self._turns[0]
            self._turns.rotate(-1)
            station = self._stations[name]
            if station.waiting and station.waiting[0][0] <= start_s:
                return station

    def _send(self, station: _Station, start_s: float) -> None:
        _, receiver, packet = station.waiting.popleft()
        station.bytes -= len(packet)
        account = station.account
        account.sent += 1
        account.bytes += len(packet)
        self._free_s = start_s + len(packet) / self._bytes_per_s
        if self.down or self._chance.random() < self._loss:
            account.lost += 1
            return
        self._count += 1
        due_s = self._free_s + self._delay_s
        heapq.heappush(self._flying, (due_s, self._count, receiver, packet))
