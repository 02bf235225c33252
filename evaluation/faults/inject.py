"""Faults of one robot or of the scene in a small live fleet: are they named, and do they do harm?

The second robot has the fault; everybody else is well. `none` is the same without any fault.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from deploy.local_fleet import LocalFleet
from evaluation.faults.faulty import CLOCK_AHEAD_S
from evaluation.fleet import (
    FleetPlan,
    open_link,
    plan_world,
    poses_now,
    start_robot,
    start_servers,
    wait_started,
)
from evaluation.fleet_scoring import SampleRow, score_sample, summarize_poses
from evaluation.observer import Observer
from evaluation.report import write_csv
from evaluation.scoring import Limits, share
from protocol.keys import Keys
from protocol.transport import wait_until

ROBOTS = 4
FAULTY = "r2"
SECONDS = 50.0
_TURNING = ("--turning", FAULTY)
_RATE_HZ = 1.0  # of the faulty robot; the others stand still
_POLL_S = 0.2


@dataclass(frozen=True)
class Fault:
    """A fault and how it shows.

    Attributes:
        kinds: of alarm that name it.
        event: beginning of the event that names it.
        world: options of the world it needs.
        in_robot: whether the robot itself is faulty.
    """

    kinds: tuple[str, ...] = ()
    event: str | None = None
    world: tuple[str, ...] = ()
    in_robot: bool = True


MOTION = "something moves in "
FAULTS = {
    "none": Fault(world=_TURNING, in_robot=False),
    "skew": Fault(("skew",), world=_TURNING),
    "clock": Fault(("clock",)),
    "baseline": Fault(("scale",)),
    "person": Fault(event=f"{MOTION}{FAULTY}'s view", world=("--person",), in_robot=False),
}


@dataclass
class Watch:
    """What the fleet's state told while a fault was there.

    Attributes:
        named_s: seconds from when all processes were up.
        alarms: robot and kind of all alarms.
        motions: robots of whose views it was told that something moves.
        texts: of the alarms and events that name the fault.
    """

    fault: Fault
    named_s: float | None = None
    alarms: set[tuple[str, str]] = field(default_factory=set)
    motions: set[str] = field(default_factory=set)
    texts: list[str] = field(default_factory=list)

    def look(self, observer: Observer, at_s: float) -> None:
        """Takes in the newest state."""
        state = observer.state
        if state is None:
            return
        self.alarms |= {(alarm.robot, alarm.kind) for alarm in state.alarms}
        moving = [event for event in state.events if event.startswith(MOTION)]
        self.motions |= {event.removeprefix(MOTION).split("'")[0] for event in moving}
        naming = [a.text for a in state.alarms if a.robot == FAULTY and a.kind in self.fault.kinds]
        if self.fault.event is not None:
            naming += [event for event in state.events if event.startswith(self.fault.event)]
        if naming and self.named_s is None:
            self.named_s, self.texts = at_s, naming

    @property
    def told(self) -> set[tuple[str, str]]:
        """Robots, and what was told of them that has nothing to do with the fault."""
        told = self.alarms - {(FAULTY, kind) for kind in self.fault.kinds}
        if self.fault.event is None:  # else who sees somebody walk is right to say so
            told |= {(robot, "moves") for robot in self.motions}
        return told

    @property
    def false_alarms(self) -> int:
        """At robots that are well."""
        healthy = not (self.fault.kinds or self.fault.event)
        return sum(healthy or robot != FAULTY for robot, _ in self.told)


def run(
    name: str,
    seconds: float,
    scratch: Path,
    logs: Path,
    progress: Callable[[], None],
    until_named: bool = False,
) -> dict[str, Any]:
    """Runs a fleet with a fault for some time, or until it is named; returns `<fault>_named` and so
    on.

    Raises:
        FleetPoseError: the fleet does not come up, or a process ends.
    """
    fault = FAULTS[name]
    names = [f"r{k + 1}" for k in range(ROBOTS)]
    plan = plan_world(names, scratch, moving=False, seed=0)
    plan = replace(plan, world=(*plan.world, *fault.world))
    watch, rows = Watch(fault), list[SampleRow]()
    with LocalFleet(logs) as fleet:
        start_servers(fleet, plan, 2, scratch / "state")
        for robot in plan.robots:
            if robot.name != FAULTY:
                start_robot(fleet, robot)
            elif fault.in_robot:
                where = (FAULTY, fleet.endpoint, fleet.site, robot.data, name, str(_RATE_HZ))
                fleet.start(FAULTY, "evaluation.faults.faulty", *where, nice=10)
            else:
                start_robot(fleet, replace(robot, rate_hz=_RATE_HZ))
        link = open_link(fleet)
        observer = Observer(link, Keys(fleet.site))
        try:
            began_s = wait_started(fleet, observer, ROBOTS)
            ahead_ns = {FAULTY: round(1e9 * CLOCK_AHEAD_S)} if name == "clock" else {}
            for second in range(1, round(seconds) + 1):
                end_s = began_s + second

                def until(end_s: float = end_s) -> bool:
                    watch.look(observer, time.monotonic() - began_s)
                    return time.monotonic() >= end_s

                wait_until(until, 2.0, poll_s=_POLL_S)
                fleet.check()
                anchor = None if observer.state is None else observer.state.anchor
                now = poses_now(observer, plan.truth, ahead_ns)
                rows += score_sample(float(second), names, now, anchor)
                progress()
                if until_named and watch.named_s is not None:
                    break
            depth_m = plan.truth.median_depth_m(observer.newest_views())
        finally:
            observer.close()
            link.close()
    return _summary(name, watch, rows, depth_m, plan, logs, fleet)


def _summary(
    name: str,
    watch: Watch,
    rows: list[SampleRow],
    depth_m: float,
    plan: FleetPlan,
    logs: Path,
    fleet: LocalFleet,
) -> dict[str, Any]:
    for text in (*watch.texts[:1], *(" ".join(alarm) for alarm in sorted(watch.told))):
        print(f"{name}: {text}")
    columns = ("time_s", "robot", "located", "verified", "position_error_m", "rotation_error_deg")
    table = [{column: getattr(row, column) for column in columns} for row in rows]
    write_csv(logs.parent.parent / f"{name}.csv", columns, table)
    poses = summarize_poses(rows, Limits.of(depth_m, rgbd=False))
    first_s = min((row.time_s for row in rows if row.located), default=float("inf"))
    after = [row for row in rows if row.time_s >= first_s]
    found = {
        "grave_located": poses["grave_located"],
        "grave_acted": poses["grave_acted"],
        "position_error_max_m": poses["position_error_max_m"],
        "located_share": share(row.located for row in after if row.robot != FAULTY),
        "located_share_faulty": share(row.located for row in after if row.robot == FAULTY),
        "false_alarms": watch.false_alarms,
        "other_alarms_faulty": len(watch.told) - watch.false_alarms,
        "leftover_processes": fleet.leftover_processes(),
    }
    if watch.fault.kinds or watch.fault.event:
        found = {"named": watch.named_s is not None, "named_s": watch.named_s, **found}
    return {f"{name}_{what}": value for what, value in found.items()}
