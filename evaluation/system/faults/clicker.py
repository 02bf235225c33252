"""An operator who clicks and erases without a pause, and keeps account of what must be there."""

import random
import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.system.faults.heard import Click, Heard, Pair, clicked
from fleetpose.evaluation.system.observer import SeenView
from fleetpose.hmi_client.network.outbox import Outbox, Ticket
from fleetpose.protocol import codec
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Correspondence, OperatorUpdate, Receipts
from fleetpose.protocol.transport import Link, Sample, wait_until

REPEAT_S = 0.5
MAX_OPEN = 40  # a person does not click on for ever while nothing is confirmed
ERASED_SHARE, MANY, ERASED_OF_MANY = 0.3, 150, 0.7  # sets stay as large as persons make them


@dataclass(frozen=True)
class Places:
    """Where a pair of robots can be clicked: pixels (N, 2) of two views that show the same."""

    i: SeenView
    j: SeenView
    uv_i: Floats
    uv_j: Floats

    @property
    def pair(self) -> Pair:
        return (self.i.view.name.robot, self.j.view.name.robot)


@dataclass
class Account:
    """What is wrong with the server's sets, seen from what it receipted."""

    lost: list[str]
    doubled: list[str]


class Clicker(Heard):
    """Clicks at a steady rate in a thread of its own; updates are repeated until receipted.

    Args:
        link, keys: of the session to use; it must outlive the clicker.
        places: where to click.
        per_s: clicks per second.
        name: the operator's.

    Attributes:
        waits_s: of every receipted update, from when it was posted to its receipt.
    """

    def __init__(
        self,
        link: Link,
        keys: Keys,
        places: Sequence[Places],
        per_s: float,
        name: str = "op-restless",
    ) -> None:
        self._outbox = Outbox(name)
        self._places = list(places)
        self._period_s = 1.0 / per_s
        self._chance = random.Random(1)
        self._tickets: list[Ticket] = []
        self._clicks: dict[int, Click] = {}  # every one ever told, by id
        self._erasing: set[int] = set()
        self._offered_s: dict[int, float] = {}
        self._posted_s: dict[int, float] = {}
        self._waited_s: list[tuple[float, float]] = []
        self.waits_s: list[float] = []
        self._ways = {places.pair: self._way(places) for places in self._places}
        self._publisher = link.latched(keys.updates(name), block=True, history=100)
        self._stop = threading.Event()
        self._pause = threading.Event()
        self._thread = threading.Thread(target=self._run, name="clicker", daemon=True)
        super().__init__(link, keys, name)

    def start(self) -> None:
        """Begins to click."""
        self._thread.start()

    def pause(self) -> None:
        """Clicks no more, but goes on offering what is open."""
        self._pause.set()

    def close(self) -> None:
        """Ends the thread."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    @property
    def receipted(self) -> int:
        """Updates that are final."""
        with self._lock:
            return sum(ticket.final for ticket in self._tickets)

    def waited_s(self, since_s: float, until_s: float) -> list[float]:
        """How long each update of this time took until its receipt; of open ones, until now."""
        with self._lock:
            now_s = time.monotonic()
            told = self._waited_s + [(at_s, now_s - at_s) for at_s in self._posted_s.values()]
        return [took_s for posted_s, took_s in told if since_s <= posted_s < until_s]

    def reasons(self) -> Counter[str]:
        """Why updates were rejected."""
        with self._lock:
            return Counter(ticket.reason for ticket in self._tickets if ticket.reason is not None)

    def in_flight(self) -> int:
        """Updates that were put and that no receipt covers."""
        with self._lock:
            return len(self._outbox.open)

    def settled(self, timeout_s: float) -> bool:
        """Waits until nothing is open; whether that came about."""
        return wait_until(lambda: not self.in_flight(), timeout_s)

    def erased(self) -> set[Click]:
        """Clicks of anybody that this operator erased, by receipt."""
        with self._lock:
            return self._erased()

    def account(self) -> Account:
        """Compares the sets that the server published last with what it receipted.

        Open updates count as lost: call it when all should be settled.
        """
        with self._lock:
            items = [(pair, item) for pair, known in self._sets.items() for item in known.items]
            there = Counter(clicked(pair, item) for pair, item in items)
            ids = Counter(item.id for _, item in items)
            erased = self._erased()
            lost = [f"{ticket.update.n} was never receipted" for ticket in self._outbox.open]
            doubled = []
            for ticket in (ticket for ticket in self._tickets if ticket.final):
                update, click = ticket.update, _of(ticket.update)
                if update.action == "erase":
                    if ticket.accepted and update.correspondence in ids:
                        lost.append(f"erasing {update.correspondence} was undone")
                elif ticket.accepted and click not in there and click not in erased:
                    lost.append(f"accepted click {click} is gone")
                elif not ticket.accepted and click in there:
                    doubled.append(f"rejected click {click} is there")
        doubled += [f"{click} is there {n} times" for click, n in there.items() if n > 1]
        doubled += [f"id {number} is there {n} times" for number, n in ids.items() if n > 1]
        return Account(lost, doubled)

    def _erased(self) -> set[Click]:
        """Clicks whose correspondence was erased, by receipt."""
        gone = {t.update.correspondence for t in self._tickets if t.accepted} - {None}
        return {click for number, click in self._clicks.items() if number in gone}

    def _run(self) -> None:
        next_s = time.monotonic()
        while not self._stop.wait(0.005):
            now_s = time.monotonic()
            if now_s >= next_s and not self._pause.is_set() and self.in_flight() < MAX_OPEN:
                self._act()
                next_s = max(next_s + self._period_s, now_s)
            self._offer(now_s)

    def _act(self) -> None:
        places = self._chance.choice(self._places)
        with self._lock:
            known = self._sets.get(places.pair)
            free = [item for item in known.items if item.id not in self._erasing] if known else []
            erased_share = ERASED_OF_MANY if len(free) > MANY else ERASED_SHARE
            if len(free) > 5 and self._chance.random() < erased_share:
                ticket = self._erase(places.pair, self._chance.choice(free))
            else:
                ticket = self._add(places)
            self._tickets.append(ticket)
            self._posted_s[ticket.update.n] = time.monotonic()

    def _erase(self, pair: Pair, item: Correspondence) -> Ticket:
        self._erasing.add(item.id)
        return self._outbox.post("erase", pair, item.revision, correspondence=item.id)

    def _add(self, places: Places) -> Ticket:
        pixel_i, pixel_j = next(self._ways[places.pair])
        return self._outbox.post(
            "add",
            places.pair,
            0,
            view_i=places.i.view.name,
            view_j=places.j.view.name,
            pixel_i=pixel_i,
            pixel_j=pixel_j,
        )

    def _way(self, places: Places) -> Iterator[tuple[Floats, Floats]]:
        """Pixels in random order, each time a bit aside, so that no two clicks are the same."""
        rng = np.random.default_rng(2)
        while True:
            for k in rng.permutation(len(places.uv_i)):
                aside = rng.uniform(-1.5, 1.5, 2)
                yield places.uv_i[k] + aside, places.uv_j[k] + aside

    def _offer(self, now_s: float) -> None:
        with self._lock:
            tickets = self._outbox.open
        for ticket in tickets:
            n = ticket.update.n
            if now_s - self._offered_s.get(n, now_s - REPEAT_S) >= REPEAT_S:
                self._offered_s[n] = now_s
                self._posted_s.setdefault(n, time.monotonic())
                self._publisher.put(codec.pack(ticket.update), codec.encoding_of(OperatorUpdate))

    def _settle(self, receipts: Receipts) -> bool:
        settled, now_s = self._outbox.settle(receipts), time.monotonic()
        for ticket in settled:
            posted_s = self._posted_s.pop(ticket.update.n)
            self._waited_s.append((posted_s, now_s - posted_s))
            self.waits_s.append(now_s - posted_s)
        return bool(settled)

    def _note_set(self, sample: Sample) -> None:
        super()._note_set(sample)
        with self._lock:
            for pair, known in self._sets.items():
                self._clicks |= {item.id: clicked(pair, item) for item in known.items}


def _of(update: OperatorUpdate) -> Click | None:
    if update.pixel_i is None:
        return None
    return (update.i, update.j, float(update.pixel_i[0]), float(update.pixel_i[1]))
