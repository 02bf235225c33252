"""Faults of one robot or of the scene in a small live fleet: are they named, and do they do harm?

The second robot has the fault; everybody else is well. `none` is the same without any fault. Some
faults are there from the beginning, others begin when all robots are located (`troubles`).
"""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.metrics.fleet_scoring import SampleRow, score_sample, summarize_poses
from fleetpose.evaluation.metrics.scoring import Limits, share
from fleetpose.evaluation.report.output import write_csv
from fleetpose.evaluation.system.faults import troubles
from fleetpose.evaluation.system.faults.troubled import CLOCK_AHEAD_S
from fleetpose.evaluation.system.faults.troubles import FAULTY, Trouble
from fleetpose.evaluation.system.fleet import (
    FleetPlan,
    observed,
    plan_world,
    poses_now,
    start_robot,
    start_servers,
    wait_started,
)
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ViewName
from fleetpose.protocol.transport import wait_until

ROBOTS = 4
_TURNING = ("--turning", FAULTY)
_RATE_HZ = 1.0  # of the faulty robot; the others stand still
_POLL_S = 0.2
_LOCATED_WITHIN_S = 120.0


@dataclass(frozen=True)
class Fault:
    """A fault and how it shows.

    Attributes:
        kinds: of alarm that name it.
        event: beginning of the event that names it.
        world: options of the world it needs.
        in_robot: whether the robot itself is faulty.
        trouble: what happens once all robots are located.
        of_all: whether every robot has it.
    """

    kinds: tuple[str, ...] = ()
    event: str | None = None
    world: tuple[str, ...] = ()
    in_robot: bool = True
    trouble: type[Trouble] = Trouble
    of_all: bool = False

    @property
    def later(self) -> bool:
        """Whether it begins in a fleet that stands located."""
        return self.trouble is not Trouble


MOTION = "something moves in "
FAULTS = {
    "none": Fault(world=_TURNING, in_robot=False),
    "skew": Fault(("skew",), world=_TURNING),
    "clock": Fault(("clock",)),
    "baseline": Fault(("scale",)),
    "mirrored": Fault(("mirrored",)),
    "person": Fault(event=f"{MOTION}{FAULTY}'s view", world=("--person",), in_robot=False),
    "frozen": Fault(("frozen", "still"), trouble=troubles.Frozen),
    "still": Fault(("still",), trouble=troubles.Still),
    "kidnapped": Fault(("lost",), trouble=troubles.Kidnapped),
    "carried": Fault(("carried",), trouble=troubles.Carried, of_all=True),
    "carried-one": Fault(("carried",), trouble=troubles.CarriedOne),
    "leave": Fault(event=f"{FAULTY} is gone", trouble=troubles.Leave),
    "old-epoch": Fault(trouble=troubles.OldEpoch, in_robot=False),
    "clock-step": Fault(
        ("clock",), event=f"the clock of {FAULTY} went back", trouble=troubles.ClockStep
    ),
}


@dataclass
class Watch:
    """What the fleet's state told while a fault was there.

    Attributes:
        named_s: seconds from when all processes were up, or the fault began.
        alarms: robot and kind of all alarms.
        motions: robots of whose views it was told that something moves.
        texts: of the alarms and events that name the fault.
    """

    fault: Fault
    named_s: float | None = None
    alarms: set[tuple[str, str]] = field(default_factory=set)
    motions: set[str] = field(default_factory=set)
    texts: list[str] = field(default_factory=list)

    def look(self, observer: Observer, at_s: float, beside: Sequence[str] = ()) -> None:
        """Takes in the newest state.

        Args:
            at_s: when; before 0 the fault is not there yet.
            beside: what names it that is not in the state.
        """
        state = observer.state
        if state is None:
            return
        self.alarms |= {(alarm.robot, alarm.kind) for alarm in state.alarms}
        moving = [event for event in state.events if event.startswith(MOTION)]
        self.motions |= {event.removeprefix(MOTION).split("'")[0] for event in moving}
        naming = [a.text for a in state.alarms if self._is_due(a.robot) and self._names(a.kind)]
        if self.fault.event is not None:
            naming += [event for event in state.events if event.startswith(self.fault.event)]
        naming += beside
        if naming and self.named_s is None and at_s >= 0:
            self.named_s, self.texts = at_s, naming

    def _is_due(self, robot: str) -> bool:
        return self.fault.of_all or robot == FAULTY

    def _names(self, kind: str) -> bool:
        return kind in self.fault.kinds

    @property
    def told(self) -> set[tuple[str, str]]:
        """Robots, and what was told of them that has nothing to do with the fault."""
        told = {one for one in self.alarms if not (self._is_due(one[0]) and self._names(one[1]))}
        if self.fault.event is None:  # else who sees somebody walk is right to say so
            told |= {(robot, "moves") for robot in self.motions}
        return told

    @property
    def false_alarms(self) -> int:
        """At robots that are well."""
        healthy = not (self.fault.kinds or self.fault.event)
        return sum(healthy or not self._is_due(robot) for robot, _ in self.told)


def run(
    name: str,
    seconds: float,
    scratch: Path,
    logs: Path,
    progress: Callable[[], None],
    until_named: bool = False,
    robots: int = ROBOTS,
) -> dict[str, Any]:
    """Runs a fleet with a fault for some time, or until it is named; returns `<fault>_named` and so
    on.

    Raises:
        FleetPoseError: the fleet does not come up, or a process ends.
    """
    fault = FAULTS[name]
    places = [f"r{k + 1}" for k in range(troubles.places_for(robots) if fault.later else robots)]
    names = places[:robots]
    plan = plan_world(places, scratch, moving=False, seed=0)
    plan = replace(plan, robots=plan.robots[:robots], world=(*plan.world, *fault.world))
    run = _Run(name, fault, Watch(fault))
    with LocalFleet(logs) as fleet:
        start_servers(fleet, plan, 2, scratch / "state")
        with observed(fleet) as observer, ExitStack() as closing:
            trouble = fault.trouble(fleet, plan, observer, observer.link, scratch)
            closing.callback(trouble.close)
            _start_robots(name, fault, trouble)
            wait_started(fleet, observer, robots)
            if fault.later:
                run.until_located(trouble, names)
                trouble.begin()
            run.watch_for(seconds, trouble, names, progress, until_named)
            depth_m = plan.truth.median_depth_m(observer.newest_views())
    return _summary(run, depth_m, plan, logs, fleet)


def _start_robots(name: str, fault: Fault, trouble: Trouble) -> None:
    """The faulty robot sends a view a second; the others stand still."""
    fleet = trouble.fleet
    for robot in trouble.plan.robots:
        if robot.name != FAULTY:
            start_robot(fleet, robot)
        elif fault.later or not fault.in_robot:
            trouble.start(replace(robot, rate_hz=_RATE_HZ))
        else:
            where = (name, FAULTY, fleet.endpoint, fleet.site, str(_RATE_HZ), robot.data)
            fleet.start(FAULTY, "fleetpose.evaluation.system.faults.troubled", *where, nice=10)


@dataclass
class _Run:
    """One fault, what was told of it, and the poses meanwhile.

    Attributes:
        again_s: seconds from the fault's end, or its beginning where it does not end, until all
            robots were located by views taken since.
    """

    name: str
    fault: Fault
    watch: Watch
    rows: list[SampleRow] = field(default_factory=list)
    again_s: float | None = None
    _began_s: float = 0.0
    _from_s: float = 0.0
    _before: Mapping[str, ViewName] = field(default_factory=dict)

    def until_located(self, trouble: Trouble, names: Sequence[str]) -> None:
        """Waits until all robots are located.

        Raises:
            FleetPoseError: they are not within two minutes.
        """

        def located() -> bool:
            self.watch.look(trouble.observer, -1.0)
            return _all_located(trouble.observer, names, {})

        if not wait_running(trouble.fleet, located, _LOCATED_WITHIN_S):
            raise FleetPoseError(
                f"{self.name}: not all robots are located after {_LOCATED_WITHIN_S:.0f} s, so that "
                f"the fault was not begun; the logs are in {trouble.fleet.directory}"
            )

    def watch_for(
        self,
        seconds: float,
        trouble: Trouble,
        names: Sequence[str],
        progress: Callable[[], None],
        until_named: bool,
    ) -> None:
        """Watches and scores once a second; a fault that ends does so after half of the time."""
        self._began_s = time.monotonic()
        self._await_again(trouble.observer)
        for second in range(1, round(seconds) + 1):
            self._watch_until(self._began_s + second, trouble, names)
            trouble.fleet.check()
            if trouble.ends and second == round(seconds) // 2:
                trouble.end()
                self._await_again(trouble.observer)
            self._score(float(second), trouble, names)
            progress()
            if until_named and self.watch.named_s is not None:
                break

    def _await_again(self, observer: Observer) -> None:
        """From now on robots are to be located by newer views."""
        self._from_s, self._before, self.again_s = time.monotonic(), _newest(observer), None

    def _watch_until(self, end_s: float, trouble: Trouble, names: Sequence[str]) -> None:
        def until() -> bool:
            now_s = time.monotonic()
            trouble.step()
            self.watch.look(trouble.observer, now_s - self._began_s, trouble.named())
            if self.again_s is None and _all_located(trouble.observer, names, self._before):
                self.again_s = now_s - self._from_s
            return now_s >= end_s

        wait_until(until, 2.0, poll_s=_POLL_S)

    def _score(self, at_s: float, trouble: Trouble, names: Sequence[str]) -> None:
        state = trouble.observer.state
        ahead_ns = trouble.ahead_ns
        if self.name == "clock":
            ahead_ns = {FAULTY: round(1e9 * CLOCK_AHEAD_S)}
        now = poses_now(trouble.poses(), trouble.truth, ahead_ns)
        self.rows += score_sample(at_s, names, now, None if state is None else state.anchor)


def _newest(observer: Observer) -> dict[str, ViewName]:
    """The newest view of each robot."""
    return {seen.view.name.robot: seen.view.name for seen in observer.newest_views()}


def _all_located(observer: Observer, names: Sequence[str], before: Mapping[str, ViewName]) -> bool:
    """Whether all robots are located, by views that were taken after those."""
    if observer.state is None:
        return False
    poses = {one.robot: one.pose for one in observer.state.robots if not one.why_not}
    return all(
        (pose := poses.get(name)) is not None and pose.located and _is_later(pose.view, before)
        for name in names
    )


def _is_later(view: ViewName, before: Mapping[str, ViewName]) -> bool:
    known = before.get(view.robot)
    return known is None or known.epoch != view.epoch or known.seq < view.seq


def _summary(
    run: _Run, depth_m: float, plan: FleetPlan, logs: Path, fleet: LocalFleet
) -> dict[str, Any]:
    name, watch, rows = run.name, run.watch, run.rows
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
    if watch.fault.later:
        found = {"located_again_s": run.again_s, **found}
    if watch.fault.kinds or watch.fault.event or watch.fault.later:
        found = {"named": watch.named_s is not None, "named_s": watch.named_s, **found}
    return {f"{name}_{what}": value for what, value in found.items()}
