"""`pose-eval soak`: a fleet of walking robots under operators who click, for hours, at a site with
certificates and two routers, while something happens to one part of it after the other.
"""

import random
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fleetpose.deploy.manifest import CONFIGURATION
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.fleets import SoakOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.evaluation.system.faults.clerk import Ledger
from fleetpose.evaluation.system.faults.clicker import Account, Clicker
from fleetpose.evaluation.system.faults.crashes import DESK, start_desk
from fleetpose.evaluation.system.faults.desk import clickable
from fleetpose.evaluation.system.field.live import router_process
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.soak.noting import Noting
from fleetpose.evaluation.system.soak.report import Soaked, write_results
from fleetpose.evaluation.system.soak.site import (
    DESK_OPERATOR,
    RESTLESS,
    ROUTERS,
    STARTED_WITHIN_S,
    SoakSite,
    soak_site,
)
from fleetpose.evaluation.system.soak.troubles import Trouble, Troubles
from fleetpose.protocol.transport import Link, wait_until

CLICKS_PER_S = 0.5
"""Of each of two operators who are in a hurry: more would have the server align their pairs all the
time, and views would wait.
"""
FLOWS_WITHIN_S = 120.0
SETTLED_WITHIN_S = 60.0
_POLL_S = 0.25
_MIN_PLACES = 30


def run(options: SoakOptions, out: Path) -> dict[str, Any]:
    """Runs the fleet for so long; writes seconds.csv, memory.csv, troubles.csv, soak.png and
    summary.json.

    Raises:
        FleetPoseError: the fleet does not come up.
    """
    logs = output_folder(out) / "logs"
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as made, ExitStack() as closing:
        scratch = Path(made)
        how = (options.robots, options.rate_hz, options.seed)
        site = closing.enter_context(soak_site(scratch, logs, *how))
        soak = _Soak.begin(site, closing)
        with progress_bar() as progress:
            task = progress.add_task("seconds", total=int(3600.0 * options.hours))
            noted = soak.run(options, lambda: progress.advance(task))
        return write_results(out, soak.finish(noted))


@dataclass
class _Soak:
    """The fleet, who clicks, and what has happened so far."""

    site: SoakSite
    observer: Observer
    clicker: Clicker
    ledger: Ledger
    pause: Path
    ended: list[str] = field(default_factory=list)
    troubles: list[Trouble] = field(default_factory=list)

    @classmethod
    def begin(cls, site: SoakSite, closing: ExitStack) -> "_Soak":
        """Waits until all robots are there, and begins to click.

        Raises:
            FleetPoseError: they are not, or no two of them see the same.
        """

        def link(who: str) -> Link:
            return closing.enter_context(site.it.link(who))

        keys, pause = site.it.field.keys, site.folder / "pause"
        observer = Observer(link("observer/wall"), keys, as_server=link("server"))
        closing.callback(observer.close)
        site.it.wait(
            lambda: observer.server_alive() and observer.alive_robots() == len(site.robots),
            "server and robots are not up",
            STARTED_WITHIN_S,
        )
        places = clickable(site.fleet, site.it.plan, observer, _MIN_PLACES)
        operator = f"operator/{RESTLESS}"
        clicker = Clicker(link(operator), keys, places, CLICKS_PER_S, RESTLESS)
        closing.callback(clicker.close)
        desk = f"operator/{DESK_OPERATOR}"
        ledger = Ledger(link(desk), keys, DESK_OPERATOR)
        configuration = site.install(desk) / CONFIGURATION
        where = (site.folder, pause, DESK_OPERATOR, configuration, 1.0 / CLICKS_PER_S)
        start_desk(site.fleet, places, *where)
        clicker.start()
        return cls(site, observer, clicker, ledger, pause)

    def run(self, options: SoakOptions, progress: Callable[[], None]) -> Noting:
        """Makes trouble after trouble, so many seconds apart; another thread notes every second."""
        truth, seconds = self.site.truth, 3600.0 * options.hours
        limits = Limits.of(truth.median_depth_m(self.observer.newest_views()), truth.rgbd)
        watched = ("server", *map(router_process, ROUTERS), *self.site.robots, DESK)
        noting = Noting(self.site, self.observer, self.clicker, limits, watched, progress)
        chance = random.Random(options.seed)
        troubles = Troubles(self.site, self.observer, chance, self._wait)
        with noting:
            for kind in troubles.order():
                if noting.now_s() + options.trouble_s >= seconds:
                    break
                self._wait(lambda: False, options.trouble_s)
                self.troubles.append(self._trouble(kind, troubles, noting))
            self._wait(lambda: False, seconds - noting.now_s())
        return noting

    def finish(self, noted: Noting) -> Soaked:
        """Ends the clicking, has the server started anew in good order, and compares what it tells
        then with what it receipted.
        """
        self.clicker.pause()
        self.pause.touch()
        settled = self._wait(lambda: not self._in_flight(), SETTLED_WITHIN_S)
        before = self.observer.server_epochs()
        self.site.fleet.restart("server")
        told = self._wait(lambda: self._heard_all(before), FLOWS_WITHIN_S)
        account = self.clicker.account()
        posted = self.site.fleet.told(DESK)
        lost, doubled = self.ledger.account(posted, self.clicker.erased())
        return Soaked(
            robots=self.site.robots,
            seconds=noted.seconds,
            memory=noted.memory,
            troubles=self.troubles,
            views_s=list(self.observer.view_to_pose_s),
            clicks_s=list(self.clicker.waits_s),
            receipted=self.clicker.receipted + self.ledger.receipted(posted),
            account=Account(account.lost + lost, account.doubled + doubled),
            settled=settled and told,
            ended=self.ended,
            undecodable=self.observer.undecodable,
        )

    def _trouble(self, kind: str, troubles: Troubles, noting: Noting) -> Trouble:
        """Makes a trouble and waits until all flows again; how long what stayed away."""
        began_s = time.monotonic()
        target = troubles.make(kind)
        over_s = time.monotonic()
        flowed = self._wait(lambda: self._flows(over_s), FLOWS_WITHIN_S)
        until_s = time.monotonic()
        poses_s = max(
            self.observer.longest_pose_gap_s(robot, began_s, until_s) for robot in self.site.robots
        )
        receipts_s = max(who.longest_gap_s(began_s, until_s) for who in (self.clicker, self.ledger))
        at_s = began_s - noting.began_s
        until_s -= noting.began_s
        return Trouble(at_s, until_s, kind, target, poses_s, receipts_s, flowed)

    def _flows(self, since_s: float) -> bool:
        """Whether each robot got a new pose, and both operators receipts."""
        posed = (self.observer.first_pose_s((one,), since_s) for one in self.site.robots)
        heard = (who.first_receipt_s(since_s) for who in (self.clicker, self.ledger))
        return all(at_s is not None for at_s in (*posed, *heard))

    def _in_flight(self) -> int:
        return self.clicker.in_flight() + self.ledger.in_flight(self.site.fleet.told(DESK))

    def _heard_all(self, before: set[str]) -> bool:
        """Whether a new server has told of all pairs."""
        new = self.observer.server_epochs() - before
        return any(self.clicker.heard_all(one) and self.ledger.heard_all(one) for one in new)

    def _wait(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Waits for a condition; a process that ends though nobody ended it is noted and started
        again. Whether the condition came about.
        """
        end_s = time.monotonic() + within_s
        while not (met := wait_until(condition, min(_POLL_S, max(end_s - time.monotonic(), 0.0)))):
            for name, last_lines in self.site.fleet.exited().items():
                print(f"{name} ended though nobody ended it; its log ends:\n{last_lines}")
                self.ended.append(name)
                self.site.fleet.restart(name)
            if time.monotonic() >= end_s:
                break
        return met
