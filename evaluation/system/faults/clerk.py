"""An operator at a headless desk, as a process that can be killed: it clicks, tells what it has
posted, and goes on where it was when it is started again.
"""

import json
import random
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fleetpose.evaluation.system.faults.clicker import Click
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol import codec
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.messages import PairCorrespondences, Receipts, ViewName
from fleetpose.protocol.transport import Link, Sample, SessionSettings, open_session

OPERATOR = "op-desk"
PERIOD_S = 0.25
MAX_OPEN = 20
CONNECT_S = 60.0


@dataclass
class Ledger:
    """What the desk posted, by its own words, beside what the server says of it.

    Args:
        link, keys: of the session to use; it must outlive the ledger.
    """

    link: Link
    keys: Keys
    _guard: threading.Lock = field(default_factory=threading.Lock)
    _covered: dict[str, int] = field(default_factory=dict)  # by session, the highest number
    _rejected: set[tuple[str, int]] = field(default_factory=set)
    _receipted_s: list[float] = field(default_factory=list)
    _sets: dict[tuple[str, str], PairCorrespondences] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.link.on_latched(self.keys.receipts(OPERATOR), self._note_receipts)
        self.link.on_latched(self.keys.correspondences("*", "*"), self._note_set)

    def first_receipt_s(self, since_s: float) -> float | None:
        """When the first receipt of something new came after a time."""
        with self._guard:
            return next((at_s for at_s in self._receipted_s if at_s > since_s), None)

    def in_flight(self, told: list[dict[str, Any]]) -> int:
        """How many of the clicks that the desk told of no receipt covers."""
        with self._guard:
            return sum(one["n"] > self._covered.get(one["session"], 0) for one in told)

    def receipted(self, told: list[dict[str, Any]]) -> int:
        """How many clicks are final."""
        return len(told) - self.in_flight(told)

    def heard_all(self, epoch: str) -> bool:
        """Whether all sets that are known are what a server of that epoch told."""
        with self._guard:
            return all(known.server_epoch == epoch for known in self._sets.values())

    def account(
        self, told: list[dict[str, Any]], erased: set[Click]
    ) -> tuple[list[str], list[str]]:
        """Clicks that are lost, and those that are there twice; call it when all is settled.

        Args:
            told: what the desk has posted.
            erased: what others erased.
        """
        with self._guard:
            there = [
                (*pair, float(item.pixel_i[0]), float(item.pixel_i[1]))
                for pair, known in self._sets.items()
                for item in known.items
            ]
            lost, doubled = [], []
            for one in told:
                click, number = tuple(one["click"]), (one["session"], one["n"])
                count = there.count(click)
                if count > 1 or (count and number in self._rejected):
                    doubled.append(f"the desk's click {click} is there {count} times")
                elif one["n"] > self._covered.get(one["session"], 0):
                    lost.append(f"the desk's click {click} was never receipted")
                elif not count and number not in self._rejected and click not in erased:
                    lost.append(f"the desk's click {click} is gone")
        return lost, doubled

    def _note_receipts(self, sample: Sample) -> None:
        try:
            receipts = codec.unpack(Receipts, sample.payload, sample.encoding)
        except CodecError:
            return
        with self._guard:
            before = self._covered.get(receipts.session, 0)
            if receipts.n > before:
                self._covered[receipts.session] = receipts.n
                self._receipted_s.append(time.monotonic())
            self._rejected |= {(receipts.session, one.n) for one in receipts.rejections}

    def _note_set(self, sample: Sample) -> None:
        try:
            known = codec.unpack(PairCorrespondences, sample.payload, sample.encoding)
        except CodecError:
            return
        with self._guard:
            self._sets[known.i, known.j] = known


def work(endpoint: str, site: str, kept: Path, places: Path, pause: Path) -> None:
    """Clicks until ended; while the file `pause` is there it only goes on offering.

    Args:
        kept: the operator's file of updates on their way.
        places: JSON, a list of pairs: both views and where to click, `view_i`, `view_j`, `uv_i`,
            `uv_j`.
    """
    pairs = json.loads(places.read_text())
    chance = random.Random(time.time_ns())  # another one in each life: no click comes twice
    session = OperatorSession(OPERATOR, kept=UpdateLog(kept))
    settings = SessionSettings(connect=(endpoint,), timeout_s=CONNECT_S)
    with Client(session, Keys(site), lambda: Link(open_session(settings))):
        while True:
            time.sleep(PERIOD_S)
            if pause.exists() or len(session.open_updates()) >= MAX_OPEN:
                continue
            pair = chance.choice(pairs)
            k = chance.randrange(len(pair["uv_i"]))
            aside = chance.uniform(-1.5, 1.5), chance.uniform(-1.5, 1.5)
            pixels = [(u + aside[0], v + aside[1]) for u, v in (pair["uv_i"][k], pair["uv_j"][k])]
            i, j = (ViewName(**pair[side]) for side in ("view_i", "view_j"))
            update = session.add(i, pixels[0], j, pixels[1]).update
            assert update.pixel_i is not None
            click = (update.i, update.j, float(update.pixel_i[0]), float(update.pixel_i[1]))
            told = {"session": update.session, "n": update.n, "click": click}
            print(json.dumps(told), flush=True)


def main() -> None:
    """Arguments ENDPOINT SITE KEPT PLACES PAUSE."""
    endpoint, site, *files = sys.argv[1:]
    log_to_stderr()
    work(endpoint, site, *(Path(file) for file in files))


if __name__ == "__main__":
    main()
