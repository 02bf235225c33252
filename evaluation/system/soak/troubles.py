"""What happens to the fleet of a soak, one thing after the other: each kind is a method that begins
it, lets it be over, and says to whom it happened.
"""

import random
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import psutil

from fleetpose.evaluation.system.faults.crashes import DESK, kill_worker
from fleetpose.evaluation.system.field.live import router_process
from fleetpose.evaluation.system.field.rotate import LINKED_S
from fleetpose.evaluation.system.field.routers import DOWN_S
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.soak.site import ROUTERS, SoakSite

FROZEN_S = 5.0
SLOW_S, SLOW_BYTES_PER_S = 20.0, 30_000.0
"""A quarter of a megabit per second: a view takes seconds unless the robot makes it smaller."""
FULL_S = 15.0
STEPPED_S = 10.0
STEPS_S = (-60.0, -5.0, 3.0, 60.0)
"""By how much a robot's clock is set: within and beyond what a pose holds, ahead and back."""
BACK_WITHIN_S = 60.0
KINDS = ("killed", "frozen", "rolled", "renewed", "rotated", "stepped", "slowed", "filled")


@dataclass(frozen=True)
class Trouble:
    """What was done to whom, and what stayed away meanwhile.

    Attributes:
        at_s, until_s: since the beginning: when it began, and when all flowed again.
        poses_away_s: the longest time that any robot got no new pose.
        receipts_away_s: the longest time that an operator who clicks got no receipt.
        flowed: whether all flowed again within the bound.
    """

    at_s: float
    until_s: float
    kind: str
    target: str
    poses_away_s: float
    receipts_away_s: float
    flowed: bool


class Troubles:
    """Makes them.

    Args:
        site: the fleet.
        observer: what is heard of it.
        chance: decides the order, and who it is.
        wait: waits for a condition within so many seconds while it looks after the processes;
            whether it came about.
    """

    def __init__(
        self,
        site: SoakSite,
        observer: Observer,
        chance: random.Random,
        wait: Callable[[Callable[[], bool], float], bool],
    ) -> None:
        self._site, self._observer, self._chance, self._wait = site, observer, chance, wait

    def order(self) -> Iterator[str]:
        """Kinds without an end: all that can be done here in some order, then in another one."""
        kinds = [kind for kind in KINDS if kind != "filled" or self._site.disk is not None]
        while True:
            self._chance.shuffle(kinds)
            yield from kinds

    def make(self, kind: str) -> str:
        """Does it to somebody, and lets it be over; who it was."""
        return getattr(self, f"_{kind}")()

    def _killed(self) -> str:
        """A process crashes and is started by its supervisor."""
        target = self._chance.choice(("server", "worker", DESK, "router", "robot"))
        if target == "worker":
            kill_worker(self._site.fleet.pid("server"))
            return target
        if target == "router":
            return self._router_killed()
        target = self._one_of(target)
        before = self._lives(target)
        self._site.fleet.kill(target)
        self._site.fleet.restart(target)
        if target != DESK:
            self._wait(lambda: bool(self._lives(target) - before), BACK_WITHIN_S)
        return target

    def _router_killed(self) -> str:
        target = self._one_of("router")
        self._site.fleet.kill(target)
        self._pass(DOWN_S)
        self._site.fleet.restart(target)
        self._pass(LINKED_S)
        return target

    def _frozen(self) -> str:
        """A process and its children stand still for a while, as on a machine that swaps."""
        target = self._one_of(self._chance.choice(("router", "server", "robot")))
        with suppress(psutil.NoSuchProcess):
            process = psutil.Process(self._site.fleet.pid(target))
            family = [process, *process.children(recursive=True)]
            _signal(family, signal.SIGSTOP)
            self._pass(FROZEN_S)
            _signal(family, signal.SIGCONT)
        return target

    def _rolled(self) -> str:
        """All but the robots get new certificates in place, and the routers are started anew in
        turn: then everybody shows the new ones.
        """
        keeper = self._site.it.field.keeper
        named = [one for one in keeper.folder.site.members() if one.role in _ROLLED]
        keeper.renew(named)
        for member in named:
            self._site.install(member.who)
        self._restart_routers()
        return "routers"

    def _renewed(self) -> str:
        """A robot gets a new certificate in place, and loses its link: it comes back with it."""
        target = self._one_of("robot")
        field = self._site.it.field
        field.keeper.renew([field.site.member(f"robot/{target}")])
        self._site.install(f"robot/{target}")
        self._site.relays[target].cut()
        return target

    def _rotated(self) -> str:
        """A robot's certificate is revoked: it gets one of the next generation, and the routers
        rules that know no other.
        """
        target = self._one_of("robot")
        field = self._site.it.field
        field.keeper.revoke(field.site.member(f"robot/{target}"))
        field.keeper.renew([field.site.member(f"robot/{target}")])
        self._site.install(f"robot/{target}")
        self._restart_routers()
        return target

    def _stepped(self) -> str:
        """A robot's clock is set, and set right a while later."""
        target, step_s = self._one_of("robot"), self._chance.choice(STEPS_S)
        self._site.set_clock(target, round(1e9 * step_s))
        self._pass(STEPPED_S)
        self._site.set_clock(target, 0)
        return target

    def _slowed(self) -> str:
        """A robot's link carries little for a while."""
        target = self._one_of("robot")
        relay = self._site.relays[target]
        relay.bytes_per_s = SLOW_BYTES_PER_S
        self._pass(SLOW_S)
        relay.bytes_per_s = None
        return target

    def _filled(self) -> str:
        """The disk of the server is nearly full for a while."""
        disk = self._site.disk
        assert disk is not None  # else it is not in the order
        disk.fill()
        self._pass(FULL_S)
        disk.empty()
        return "server"

    def _restart_routers(self) -> None:
        for name in ROUTERS:
            self._site.install(f"router/{name}")
            self._site.fleet.restart(router_process(name))
            self._pass(LINKED_S)

    def _lives(self, target: str) -> set[str]:
        if target == "server":
            return self._observer.server_epochs()
        return self._observer.lives(target)

    def _one_of(self, target: str) -> str:
        if target == "router":
            return router_process(self._chance.choice(ROUTERS))
        return self._chance.choice(self._site.robots) if target == "robot" else target

    def _pass(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        self._wait(lambda: time.monotonic() >= end_s, seconds + 1.0)


_ROLLED = ("router", "server", "operator", "observer")


def _signal(family: list[psutil.Process], number: signal.Signals) -> None:
    for process in family:
        with suppress(psutil.NoSuchProcess):
            process.send_signal(number)
