"""An operator who clicks without a pause while something happens to the site, and the account."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import Any

from fleetpose.evaluation.system.faults.clicker import Clicker
from fleetpose.evaluation.system.faults.desk import clickable
from fleetpose.evaluation.system.field.live import Live
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.transport import Link

CLICKS_PER_S = 20.0
MIN_PLACES = 30
SETTLED_WITHIN_S = 30.0
FLOWS_WITHIN_S = 60.0


@dataclass
class Clicking:
    """Clicks of operator anna, and what the server hears of robots, by sessions of their own."""

    it: Live
    views: Observer
    clicker: Clicker
    link: Link

    def routers(self) -> set[str]:
        """The ids of the routers, new in each life, that the operator is connected to."""
        return {str(one) for one in self.link.session.info.routers_zid()}

    def wait_receipt(self, since_s: float) -> None:
        """Waits for the first receipt after a time.

        Raises:
            FleetPoseError: none comes in a minute.
        """
        flows = lambda: self.clicker.first_receipt_s(since_s) is not None  # noqa: E731
        self.it.wait(flows, "clicks are not receipted", FLOWS_WITHIN_S)

    def account(self) -> dict[str, Any]:
        """Stops to click, has the server started again, and compares what it tells then with what
        it receipted.
        """
        self.clicker.pause()
        settled = self.clicker.settled(SETTLED_WITHIN_S)
        before = self.views.server_epochs()
        self.it.fleet.restart("server")
        self.it.wait(lambda: bool(self.views.server_epochs() - before), "the server is not back")
        (epoch,) = self.views.server_epochs() - before
        self.it.wait(lambda: self.clicker.heard_all(epoch), "sets are not told again")
        account = self.clicker.account()
        for sentence in (*account.lost[:5], *account.doubled[:5]):
            print(sentence)
        return {
            "receipted": self.clicker.receipted,
            "settled": settled,
            "lost": len(account.lost),
            "doubled": len(account.doubled),
        }


@contextmanager
def clicking(it: Live, per_s: float = CLICKS_PER_S) -> Iterator[Clicking]:
    """Clicks where robots see the same, once the first click is receipted.

    Args:
        it: the fleet.
        per_s: clicks per second.

    Raises:
        FleetPoseError: nothing can be clicked, or clicks are not receipted.
    """
    with ExitStack() as closing:
        views = Observer(closing.enter_context(it.link("server")), it.field.keys)
        closing.callback(views.close)
        places = clickable(it.fleet, it.plan, views, MIN_PLACES)
        link = closing.enter_context(it.link("operator/anna"))
        clicker = Clicker(link, it.field.keys, places, per_s, "anna")
        closing.callback(clicker.close)
        found = Clicking(it, views, clicker, link)
        clicker.start()
        found.wait_receipt(time.monotonic())
        yield found
