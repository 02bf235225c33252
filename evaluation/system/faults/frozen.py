"""One operator's client is frozen: what the others see meanwhile, and how it comes back."""

import os
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.system.faults.desk import clickable, operator, replayed_fleet
from fleetpose.evaluation.system.faults.heard import Pair
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

ROBOTS = 4
BEFORE_S = 10.0
BACK_WITHIN_S = 30.0
WARM_WITHIN_S = 60.0
_READER = "reader"


@dataclass
class Arrivals:
    """When something new arrived at an operator's desk, in a thread of its own.

    Attributes:
        states: of the fleet's state, pictures: of either picture, poses: of any pose.
    """

    session: OperatorSession
    pair: Pair
    states: list[float] = field(default_factory=list)
    poses: list[float] = field(default_factory=list)
    pictures: list[float] = field(default_factory=list)
    _stop: threading.Event = field(default_factory=threading.Event)

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name="arrivals", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        told: tuple[object, ...] = (None, None, None)
        while not self._stop.is_set():
            seen = self.session.revisions()
            now = (self._state(), self._poses(), self._pictures())
            for kind, before, after in zip(
                (self.states, self.poses, self.pictures), told, now, strict=True
            ):
                if before != after:
                    kind.append(time.monotonic())
            told = now
            self.session.wait_change(seen, ("fleet", "poses", "pictures"), 0.1)

    def _state(self) -> object:
        return self.session.fleet.n if self.session.fleet else None

    def _poses(self) -> object:
        return {name: pose.n for name, pose in self.session.poses().items()}

    def _pictures(self) -> object:
        return [p.view if (p := self.session.picture(robot)) else None for robot in self.pair]


def run(seconds: float, scratch: Path, logs: Path, progress: Callable[[], None]) -> dict[str, Any]:
    """Freezes one of two clients for some seconds.

    Returns:
        Longest gaps of the other client before and during, and how long the frozen one took to
        show a state as new as the other's at the moment it was let go.

    Raises:
        FleetPoseError: the fleet does not come up, or the frozen client never comes back.
    """
    with replayed_fleet(ROBOTS, scratch, logs) as (fleet, plan, observer):
        pair = clickable(fleet, plan, observer)[0].pair
        module = "fleetpose.evaluation.system.faults.desk"
        where = ("op-frozen", fleet.endpoint, fleet.site)
        fleet.start(_READER, module, *where, *pair, json_lines=True)
        with operator("op-awake", fleet.endpoint, fleet.site, pair) as session:
            arrivals = Arrivals(session, pair)
            if not wait_running(fleet, lambda: _warm(fleet, session, pair), WARM_WITHIN_S):
                raise FleetPoseError(f"no images at the desks; logs: {fleet.directory}")
            arrivals.start()
            began_s = _pass(BEFORE_S, progress)
            os.kill(fleet.pid(_READER), signal.SIGSTOP)
            try:
                frozen_s = _pass(seconds, progress)
            finally:
                os.kill(fleet.pid(_READER), signal.SIGCONT)
            thawed_s = time.monotonic()
            newest = session.fleet.n if session.fleet else 0
            caught_up_s = _back(fleet, newest, thawed_s)
            arrivals.stop()
    summary: dict[str, Any] = {"caught_up_s": caught_up_s}
    for what in ("states", "poses", "pictures"):
        times = getattr(arrivals, what)
        summary[f"gap_{what}_before_s"] = _longest_gap(times, began_s, frozen_s)
        summary[f"gap_{what}_frozen_s"] = _longest_gap(times, frozen_s, thawed_s)
    return summary


def _warm(fleet: LocalFleet, session: OperatorSession, pair: Pair) -> bool:
    """Whether both clients show both pictures."""
    mine = all(session.picture(robot) is not None for robot in pair)
    return mine and any(None not in line["pictures"] for line in fleet.told(_READER))


def _pass(seconds: float, progress: Callable[[], None]) -> float:
    """Lets time pass; when it began."""
    began_s = time.monotonic()
    for second in range(1, round(seconds) + 1):
        wait_until(lambda end=began_s + second: time.monotonic() >= end, 2.0)
        progress()
    return began_s


def _back(fleet: LocalFleet, newest: int, thawed_s: float) -> float:
    """Seconds until the frozen client shows what is new."""

    def shown() -> list[float]:
        return [
            line["at_s"]
            for line in fleet.told(_READER)
            if line["at_s"] >= thawed_s and line["state"] >= newest
        ]

    if not wait_running(fleet, lambda: bool(shown()), BACK_WITHIN_S):
        raise FleetPoseError(f"the frozen client is not back; logs: {fleet.directory}")
    return min(shown()) - thawed_s


def _longest_gap(times: list[float], from_s: float, to_s: float) -> float:
    """The longest time without an arrival within a stretch, its ends included."""
    inside = [from_s, *(at_s for at_s in times if from_s < at_s < to_s), to_s]
    return max(b - a for a, b in pairwise(inside))
