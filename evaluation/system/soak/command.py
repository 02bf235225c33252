"""`pose-eval soak`: a fleet of walking robots under an operator who clicks, for hours, while one
process after the other is killed or frozen. Every second memory, latencies and errors are noted.
"""

import random
import signal
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import psutil

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.metrics.fleet_scoring import is_grave, score_sample
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.fleets import SoakOptions
from fleetpose.evaluation.report.output import output_folder, progress_bar
from fleetpose.evaluation.system.faults.clerk import Ledger
from fleetpose.evaluation.system.faults.clicker import Account, Clicker
from fleetpose.evaluation.system.faults.crashes import (
    DESK,
    TARGETS,
    kill,
    restart_and_hear_all,
    start_desk,
)
from fleetpose.evaluation.system.faults.desk import clickable
from fleetpose.evaluation.system.fleet import (
    FleetPlan,
    observed,
    plan_world,
    poses_now,
    start,
    wait_started,
)
from fleetpose.evaluation.system.memory import resident_mb
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.soak.report import Second, Soaked, Trouble, write_results
from fleetpose.protocol.transport import wait_until

CLICKS_PER_S = 2.0
FROZEN_S = 5.0
SETTLED_WITHIN_S = 30.0
_FREEZABLE = ("router", "server", "robot")
_MIN_PLACES = 30


def run(options: SoakOptions, out: Path) -> dict[str, Any]:
    """Runs the fleet for so long; writes seconds.csv, troubles.csv, plots and summary.json.

    Raises:
        FleetPoseError: the fleet does not come up, or not again after a trouble.
        ProcessEndedError: a process ended that nobody killed.
    """
    seconds = 3600.0 * options.hours
    logs = output_folder(out) / "logs"
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as made, ExitStack() as closing:
        scratch = Path(made)
        names = [f"r{k + 1}" for k in range(options.robots)]
        plan = plan_world(names, scratch, moving=True, seed=options.seed)
        slower = tuple(replace(robot, rate_hz=options.rate_hz) for robot in plan.robots)
        plan = replace(plan, robots=slower)
        fleet = closing.enter_context(LocalFleet(logs))
        start(fleet, plan, 2, scratch / "state")
        observer = closing.enter_context(observed(fleet))
        wait_started(fleet, observer, options.robots)
        soak = _Soak.begin(fleet, plan, observer, scratch, random.Random(options.seed))
        closing.callback(soak.clicker.close)
        with progress_bar() as progress:
            task = progress.add_task("seconds", total=int(seconds))
            soak.run(seconds, options.trouble_s, lambda: progress.advance(task))
        account, told = soak.finish(scratch / "pause")
        soaked = Soaked(
            plan.names,
            soak.seconds,
            soak.troubles,
            receipted=soak.clicker.receipted + soak.ledger.receipted(fleet.told(DESK)),
            account=account,
            told=told,
            undecodable=observer.undecodable,
        )
    return write_results(out, soaked)


@dataclass
class _Soak:
    fleet: LocalFleet
    plan: FleetPlan
    observer: Observer
    clicker: Clicker
    ledger: Ledger
    chance: random.Random
    limits: Limits
    seconds: list[Second] = field(default_factory=list)
    troubles: list[Trouble] = field(default_factory=list)
    _views_told: int = 0
    _began_s: float = 0.0

    @classmethod
    def begin(
        cls,
        fleet: LocalFleet,
        plan: FleetPlan,
        observer: Observer,
        scratch: Path,
        chance: random.Random,
    ) -> "_Soak":
        places = clickable(fleet, plan, observer, _MIN_PLACES)
        clicker = Clicker(observer.link, observer.keys, places, CLICKS_PER_S)
        clicker.start()
        ledger = Ledger(observer.link, observer.keys)
        start_desk(fleet, places, scratch, scratch / "pause")
        limits = Limits.of(plan.truth.median_depth_m(observer.newest_views()), plan.truth.rgbd)
        return cls(fleet, plan, observer, clicker, ledger, chance, limits)

    def run(self, seconds: float, trouble_s: float, progress: Callable[[], None]) -> None:
        """Makes trouble every so many seconds; another thread notes every second."""
        self._began_s = time.monotonic()
        ended = threading.Event()
        noting = threading.Thread(target=self._note_all, args=(ended, progress), daemon=True)
        noting.start()
        try:
            while (now_s := self._now_s()) + trouble_s < seconds:
                wait_running(self.fleet, lambda: False, trouble_s)
                self._trouble()
            wait_running(self.fleet, lambda: False, seconds - now_s)
        finally:
            ended.set()
            noting.join()

    def finish(self, pause: Path) -> tuple[Account, bool]:
        """Ends the clicking; compares what the server kept with what it receipted; whether all was
        settled and told.
        """
        self.clicker.pause()
        pause.touch()
        settled = self.clicker.settled(SETTLED_WITHIN_S) and wait_until(
            lambda: self.ledger.in_flight(self.fleet.told(DESK)) == 0, SETTLED_WITHIN_S
        )
        told = restart_and_hear_all(self.fleet, self.observer, self.clicker, self.ledger)
        account = self.clicker.account()
        lost, doubled = self.ledger.account(self.fleet.told(DESK), self.clicker.erased())
        account.lost.extend(lost)
        account.doubled.extend(doubled)
        return account, settled and told

    def _now_s(self) -> float:
        return time.monotonic() - self._began_s

    def _note_all(self, ended: threading.Event, progress: Callable[[], None]) -> None:
        while not ended.wait(1.0):
            self._note(self._now_s())
            progress()

    def _note(self, now_s: float) -> None:
        anchor = None if self.observer.state is None else self.observer.state.anchor
        rows = score_sample(
            now_s, self.plan.names, poses_now(self.observer, self.plan.truth), anchor
        )
        waits_s = self.observer.view_to_pose_s[self._views_told :]
        self._views_told += len(waits_s)
        self.seconds.append(
            Second(
                at_s=now_s,
                located=sum(row.located for row in rows),
                grave=sum(is_grave(row, self.limits) for row in rows),
                server_mb=resident_mb(self.fleet.pid("server")),
                router_mb=resident_mb(self.fleet.pid("router")),
                robots_mb=max(resident_mb(self.fleet.pid(name)) for name in self.plan.names),
                operator_mb=resident_mb(self.fleet.pid(DESK)),
                view_to_pose_s=max(waits_s, default=None),
                in_flight=self.clicker.in_flight(),
            )
        )

    def _trouble(self) -> None:
        """Kills a process and has it started again, or lets one stand still for a while."""
        now_s = self._now_s()
        if self.chance.random() < len(_FREEZABLE) / (len(_FREEZABLE) + len(set(TARGETS))):
            target = self._one_of(self.chance.choice(_FREEZABLE))
            self._freeze(target)
            self.troubles.append(Trouble(now_s, "frozen", target, self._now_s() - now_s))
        else:
            target = self._one_of(self.chance.choice(TARGETS))
            noted = kill(self.fleet, self.observer, self.clicker, self.ledger, target)
            self.troubles.append(Trouble(now_s, "killed", target, noted.recovery_s))

    def _one_of(self, target: str) -> str:
        return self.chance.choice(self.plan.names) if target == "robot" else target

    def _freeze(self, target: str) -> None:
        """Stops a process and its children for a while, as a machine does that swaps."""
        process = psutil.Process(self.fleet.pid(target))
        family = [process, *process.children(recursive=True)]
        for one in family:
            one.send_signal(signal.SIGSTOP)
        wait_until(lambda: False, FROZEN_S)
        for one in family:
            one.send_signal(signal.SIGCONT)
