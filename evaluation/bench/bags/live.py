"""Two live robots that play bags, and a live server: located, where they truly were, not blamed."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.bench.bags.truth import RobotBag
from fleetpose.evaluation.metrics.geometry import Floats, inverse, se3_log
from fleetpose.evaluation.report.bars import Bar
from fleetpose.evaluation.system.fleet import observed, wait_started
from fleetpose.evaluation.system.observer import Observer, SeenPose
from fleetpose.protocol.transport import wait_until

LOCATED_WITHIN_S = 60.0
_SPEED, _RATE_HZ = 0.2, 2.0  # sample bags are short: newest-wins drops views 0.33 s apart
_EVERY_S = 0.5


@dataclass
class Watched:
    """What was seen of a fleet, over all samples.

    Attributes:
        verified: robots that were verified and located in all samples, the anchor included.
        errors_m, errors_deg: of T_i_j of each two robots in each sample.
        clock_alarms: samples in which a clock was blamed.
        stale: poses that were no longer valid when they were looked at.
        why_not: what the server said of robots that it did not locate.
    """

    samples: int = 0
    verified: set[str] = field(default_factory=set)
    errors_m: list[float] = field(default_factory=list)
    errors_deg: list[float] = field(default_factory=list)
    clock_alarms: int = 0
    stale: int = 0
    why_not: set[str] = field(default_factory=set)

    def bars(self, what: str, robots: int, limits: tuple[float, float]) -> list[Bar]:
        """All robots verified, within metres and degrees, no clock alarm, nothing stale."""
        worst_m, worst_deg = (
            max(errors) if errors else None for errors in (self.errors_m, self.errors_deg)
        )
        return [
            Bar(f"{what}: robots verified and located", len(self.verified), robots, at_least=True),
            Bar(f"{what}: position off, m", worst_m, limits[0]),
            Bar(f"{what}: turn off, deg", worst_deg, limits[1]),
            Bar(f"{what}: alarms about clocks", self.clock_alarms, 0.0),
            Bar(f"{what}: stale poses", self.stale, 0.0),
        ]


def watch(bags: Mapping[str, RobotBag], logs: Path, seconds: float) -> Watched:
    """Runs real agents on bags and a real server, and looks at the poses.

    Raises:
        FleetPoseError: a process ended, or does not start.
    """
    seen = Watched()
    with LocalFleet(logs) as fleet:
        fleet.start_router()
        fleet.start_server("--workers", "1")
        for name, bag in bags.items():
            played = ("--replay", "loop", "--speed", str(_SPEED), "--rate", str(_RATE_HZ))
            fleet.start_robot(name, "bag", str(bag.path), *played)
        with observed(fleet) as observer:
            wait_started(fleet, observer, len(bags))
            wait_running(fleet, lambda: _all_located(observer, bags), LOCATED_WITHIN_S)
            seen.verified = set(bags)
            end_s = time.monotonic() + seconds
            while time.monotonic() < end_s:
                fleet.check()
                _note(observer, bags, seen)
                wait_until(lambda: False, _EVERY_S)
    return seen


def _all_located(observer: Observer, bags: Mapping[str, RobotBag]) -> bool:
    poses = observer.poses()
    return all(name in poses and poses[name].pose.located for name in bags)


def _note(observer: Observer, bags: Mapping[str, RobotBag], seen: Watched) -> None:
    poses = observer.poses()
    seen.samples += 1
    located = {name for name, one in poses.items() if one.pose.located}
    seen.verified &= {name for name in located if poses[name].pose.verdict == "verified"}
    seen.stale += sum(not _is_valid(one) for one in poses.values())
    state = observer.state
    if state is not None:
        seen.why_not |= {f"{one.robot}: {one.why_not}" for one in state.robots if one.why_not}
    alarms = () if state is None else state.alarms
    seen.clock_alarms += any(alarm.kind == "clock" for alarm in alarms)
    where = {name: _both(observer, bags[name], poses[name]) for name in sorted(located & set(bags))}
    for a, b in combinations([both for both in where.values() if both is not None], 2):
        found, true = (inverse(T_a) @ T_b for T_a, T_b in zip(a, b, strict=True))
        off = inverse(true) @ found
        seen.errors_m.append(float(np.linalg.norm(off[:3, 3])))
        seen.errors_deg.append(float(np.degrees(np.linalg.norm(se3_log(off)[:3]))))


def _both(observer: Observer, bag: RobotBag, seen: SeenPose) -> tuple[Floats, Floats] | None:
    """T_fleet_robot as published, and T_world_robot; None of a view that did not come here."""
    view = observer.view(seen.pose.view)
    T_world_robot = None if view is None else bag.T_world_robot(view)
    if T_world_robot is None:
        return None
    return np.asarray(seen.pose.T_fleet_robot, np.float64), T_world_robot


def _is_valid(seen: SeenPose) -> bool:
    """As any consumer counts it, from the pose's arrival here."""
    return time.monotonic() < seen.received_s + seen.pose.valid_for_s
