"""All kinds of processes killed at random moments while operators click."""

import json
import random
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.report.output import write_csv
from fleetpose.evaluation.system.faults.clerk import OPERATOR, PERIOD_S, Ledger
from fleetpose.evaluation.system.faults.clicker import Clicker, Places
from fleetpose.evaluation.system.faults.desk import clickable
from fleetpose.evaluation.system.fleet import observed, plan_world, start, wait_started
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

ROBOTS = 3
CLICKS_PER_S = 60.0
UP_WITHIN_S = 60.0
SETTLED_WITHIN_S = 30.0
_PAUSE_S = (0.2, 1.5)  # between everything running again and the next kill
TARGETS = ("server",) * 4 + ("router", "router", "robot", "worker", "desk", "desk")
DESK = "desk"
KINDS = ("server", "worker", "router", "robot", "desk")
_MIN_PLACES = 30


@dataclass
class Kill:
    """What was noted of one kill.

    Attributes:
        target: the process.
        in_flight: updates that were put and not receipted at that moment.
        up_s: from the kill until it was up again: the server's token, the router's port, the
            robot's token; a desk is up at once.
        recovery_s: from the kill to the next receipt, of the desk where it was killed.
        poses_s: from being up to a new pose of every robot; of server and router only.
    """

    target: str
    in_flight: int
    up_s: float = 0.0
    recovery_s: float = 0.0
    poses_s: float | None = None


def run(
    kills: int, seed: int, scratch: Path, logs: Path, progress: Callable[[], None]
) -> dict[str, Any]:
    """Runs a small fleet, kills its processes and counts what the operator lost.

    Raises:
        FleetPoseError: the fleet does not come up, or not again.
    """
    chance = random.Random(seed)
    plan = plan_world([f"r{k + 1}" for k in range(ROBOTS)], scratch, moving=False, seed=0)
    noted: list[Kill] = []
    with LocalFleet(logs) as fleet, ExitStack() as closing:
        start(fleet, plan, 2, scratch / "state")
        observer = closing.enter_context(observed(fleet))
        wait_started(fleet, observer, ROBOTS)
        places = clickable(fleet, plan, observer, _MIN_PLACES)
        clicker = Clicker(observer.link, observer.keys, places, CLICKS_PER_S)
        closing.callback(clicker.close)
        clicker.start()
        ledger = Ledger(observer.link, observer.keys)
        pause = scratch / "pause"
        start_desk(fleet, places, scratch, pause)
        for _ in range(kills):
            target = chance.choice(TARGETS)
            target = chance.choice(plan.names) if target == "robot" else target
            time.sleep(chance.uniform(*_PAUSE_S))
            noted.append(kill(fleet, observer, clicker, ledger, target))
            progress()
        clicker.pause()
        pause.touch()
        settled = clicker.settled(SETTLED_WITHIN_S) and wait_until(
            lambda: ledger.in_flight(fleet.told(DESK)) == 0, SETTLED_WITHIN_S
        )
        told = restart_and_hear_all(fleet, observer, clicker, ledger)
        account = clicker.account()
        told_clicks = fleet.told(DESK)
        lost, doubled = ledger.account(told_clicks, clicker.erased())
        account.lost.extend(lost)
        account.doubled.extend(doubled)
    for sentence in (*account.lost[:10], *account.doubled[:10]):
        print(sentence)
    write_csv(logs.parent.parent / "kills.csv", Kill, noted)
    return {
        "kills": kills,
        **{f"kills_{kind}": sum(_kind(k.target) == kind for k in noted) for kind in KINDS},
        "receipted": clicker.receipted + ledger.receipted(told_clicks),
        "receipted_desk": ledger.receipted(told_clicks),
        "rejected": sum(clicker.reasons().values()),
        "settled": settled and told,
        "in_flight_at_kill": sum(kill.in_flight for kill in noted),
        "lost": len(account.lost),
        "doubled": len(account.doubled),
        "in_flight_at_kill_desk": sum(k.in_flight for k in noted if k.target == DESK),
        "recovery_s_p95": float(np.percentile([kill.recovery_s for kill in noted], 95)),
        "poses_after_server_s": _longest(noted, "server"),
        "poses_after_router_s": _longest(noted, "router"),
        "leftover_processes": fleet.leftover_processes(),
    }


def _kind(target: str) -> str:
    return target if target in KINDS else "robot"


def start_desk(
    fleet: LocalFleet,
    places: list[Places],
    scratch: Path,
    pause: Path,
    operator: str = OPERATOR,
    configuration: Path | None = None,
    period_s: float = PERIOD_S,
) -> None:
    """Starts the client of an operator who clicks at the same places.

    Args:
        configuration: of zenoh; else the fleet's router is asked.
        period_s: between two clicks.
    """
    pairs = [
        {
            "view_i": one.i.view.name.model_dump(),
            "view_j": one.j.view.name.model_dump(),
            "uv_i": one.uv_i.tolist(),
            "uv_j": one.uv_j.tolist(),
        }
        for one in places
    ]
    file = scratch / "places.json"
    file.write_text(json.dumps(pairs))
    files = (scratch / "updates.sqlite", file, pause)
    router = fleet.endpoint if configuration is None else str(configuration)
    where = (router, fleet.site, operator, str(period_s), *(str(path) for path in files))
    fleet.start(DESK, "fleetpose.evaluation.system.faults.clerk", *where, json_lines=True)


def _longest(noted: list[Kill], target: str) -> float | None:
    seconds = [kill.poses_s for kill in noted if kill.target == target]
    return max((s for s in seconds if s is not None), default=None)


def kill(
    fleet: LocalFleet, observer: Observer, clicker: Clicker, ledger: Ledger, target: str
) -> Kill:
    """Kills a process, starts it again as a supervisor would, and waits until all flows."""
    in_flight = clicker.in_flight() if target != DESK else ledger.in_flight(fleet.told(DESK))
    noted = Kill(target, in_flight)
    before, killed_s = observer.server_epochs(), time.monotonic()
    lives = observer.lives(target)
    if target == "worker":  # the server starts another one
        kill_worker(fleet.pid("server"))
    else:
        fleet.kill(target)
        fleet.restart(target)
    if target == "router":
        fleet.wait_accepting()
    elif target == "server":
        if not wait_running(fleet, lambda: bool(observer.server_epochs() - before), UP_WITHIN_S):
            raise FleetPoseError(f"the server is not back; its log ends:\n{fleet.tail('server')}")
    elif _kind(target) == "robot" and not wait_running(
        fleet, lambda: bool(observer.lives(target) - lives), UP_WITHIN_S
    ):
        raise FleetPoseError(f"{target} is not back; logs: {fleet.directory}")
    up_s = time.monotonic()
    noted.up_s = up_s - killed_s
    if target in ("server", "router"):
        noted.poses_s = _poses_anew(fleet, observer, up_s)
    whose = ledger if target == DESK else clicker
    since_s = up_s if target == DESK else killed_s
    if not wait_running(fleet, lambda: whose.first_receipt_s(since_s) is not None, UP_WITHIN_S):
        raise FleetPoseError(f"no receipts after {target} was killed; logs: {fleet.directory}")
    first_s = whose.first_receipt_s(since_s)
    assert first_s is not None
    noted.recovery_s = first_s - killed_s
    return noted


def kill_worker(server: int) -> None:
    """Kills the largest of a server's workers, if it has any at this moment."""
    workers: list[tuple[int, psutil.Process]] = []
    for process in psutil.Process(server).children(recursive=True):
        with suppress(psutil.Error):  # it ended while we looked
            if not process.children():
                workers.append((process.memory_info().rss, process))
    if workers:
        with suppress(psutil.NoSuchProcess):
            max(workers, key=lambda one: one[0])[1].kill()


def _poses_anew(fleet: LocalFleet, observer: Observer, since_s: float) -> float:
    """Waits for a new pose of every robot; seconds from the given moment to the last of them."""

    def times() -> list[float | None]:
        robots = list(observer.poses())
        return [observer.first_pose_s((robot,), since_s) for robot in robots]

    if not wait_running(fleet, lambda: all(at is not None for at in times()), UP_WITHIN_S):
        raise FleetPoseError(f"poses do not flow again; logs: {fleet.directory}")
    return max((at - since_s for at in times() if at is not None), default=0.0)


def restart_and_hear_all(
    fleet: LocalFleet, observer: Observer, clicker: Clicker, ledger: Ledger
) -> bool:
    """Ends and starts the server in good order, so that what it then tells is what it kept; whether
    it told of every pair.
    """
    before = observer.server_epochs()
    fleet.restart("server")
    if not wait_running(fleet, lambda: bool(observer.server_epochs() - before), UP_WITHIN_S):
        return False
    (epoch,) = observer.server_epochs() - before
    return wait_until(lambda: clicker.heard_all(epoch) and ledger.heard_all(epoch), UP_WITHIN_S)
