"""An operator at a headless desk, as a process that can be killed: it clicks, tells what it has
posted, and goes on where it was when it is started again.
"""

import json
import random
import sys
import time
from pathlib import Path
from typing import Any

from fleetpose.evaluation.system.faults.heard import Click, Heard, clicked
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.logs import log_to_stderr
from fleetpose.protocol.messages import Receipts, ViewName
from fleetpose.protocol.transport import Link, SessionSettings, open_session

OPERATOR = "op-desk"
PERIOD_S = 0.25
MAX_OPEN = 20
CONNECT_S = 60.0


class Ledger(Heard):
    """What the desk posted, by its own words, beside what the server says of it.

    Args:
        link, keys: of the session to use; it must outlive this.
        operator: who sits there.
    """

    def __init__(self, link: Link, keys: Keys, operator: str = OPERATOR) -> None:
        self._covered: dict[str, int] = {}  # by session, the highest number
        self._rejected: set[tuple[str, int]] = set()
        super().__init__(link, keys, operator)

    def in_flight(self, told: list[dict[str, Any]]) -> int:
        """How many of the clicks that the desk told of no receipt covers."""
        with self._lock:
            return sum(one["n"] > self._covered.get(one["session"], 0) for one in told)

    def receipted(self, told: list[dict[str, Any]]) -> int:
        """How many clicks are final."""
        return len(told) - self.in_flight(told)

    def account(
        self, told: list[dict[str, Any]], erased: set[Click]
    ) -> tuple[list[str], list[str]]:
        """Clicks that are lost, and those that are there twice; call it when all is settled.

        Args:
            told: what the desk has posted.
            erased: what others erased.
        """
        with self._lock:
            sets = self._sets.items()
            there = [clicked(pair, item) for pair, known in sets for item in known.items]
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

    def _settle(self, receipts: Receipts) -> bool:
        is_new = receipts.n > self._covered.get(receipts.session, 0)
        if is_new:
            self._covered[receipts.session] = receipts.n
        self._rejected |= {(receipts.session, one.n) for one in receipts.rejections}
        return is_new


def work(
    settings: SessionSettings,
    site: str,
    operator: str,
    period_s: float,
    kept: Path,
    places: Path,
    pause: Path,
) -> None:
    """Clicks until ended; while the file `pause` is there it only goes on offering.

    Args:
        settings: of the connection; site: of its keys; operator: who clicks.
        period_s: between two clicks.
        kept: the operator's file of updates on their way.
        places: JSON, a list of pairs: both views and where to click, `view_i`, `view_j`, `uv_i`,
            `uv_j`.
    """
    pairs = json.loads(places.read_text())
    chance = random.Random(time.time_ns())  # another one in each life: no click comes twice
    session = OperatorSession(operator, kept=UpdateLog(kept))
    with Client(session, Keys(site), lambda: Link(open_session(settings))):
        while True:
            time.sleep(period_s)
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
    """Arguments ROUTER SITE OPERATOR PERIOD KEPT PLACES PAUSE; ROUTER: an endpoint, or a file of
    zenoh's configuration.
    """
    router, site, operator, period_s, *files = sys.argv[1:]
    log_to_stderr()
    if router.endswith(".json5"):
        settings = SessionSettings(config_file=Path(router), timeout_s=CONNECT_S)
    else:
        settings = SessionSettings(connect=(router,), timeout_s=CONNECT_S)
    work(settings, site, operator, float(period_s), *(Path(file) for file in files))


if __name__ == "__main__":
    main()
