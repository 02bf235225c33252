"""`pose-eval ros`: stand-ins for robots that run ROS 2, agents and a server, against the truth."""

import re
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np

from fleetpose.deploy.local_fleet import ROBOT_NICE, LocalFleet, wait_running
from fleetpose.evaluation.metrics.fleet_scoring import SampleRow, score_sample
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.options.ros import DIALECTS, RosOptions
from fleetpose.evaluation.report import output
from fleetpose.evaluation.system.fleet import observed, poses_now, wait_started
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.evaluation.system.truth import Truth
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.rosmsg.live.names import name_of

FIRST_POSE_S, MB_PER_S, CORE_PERCENT = 10.0, 3.0, 3.0
"""The bars."""
_UP_WITHIN_S = 150.0  # on a machine that has other things to do
_COLUMNS = {
    "robot": "name",
    "dialect": "dialect",
    "verified": "verified",
    "off m": "position_error_m",
    "off deg": "rotation_error_deg",
    "MB/s": "agent_mb_per_s",
    "core %": "alone_core_percent",
    "age ms": "alone_age_ms",
}
_TOOK = re.compile(r" took pairs=(\d+) mb_per_s=([\d.]+)")


@dataclass(frozen=True)
class StandingTruth:
    """Where robots that stand truly are, by their names in the fleet."""

    T_world_robots: Mapping[str, Floats]
    rgbd: bool = False

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        """(4, 4), whatever the view."""
        return self.T_world_robots.get(seen.view.name.robot)


@dataclass
class Robot:
    """One stand-in and what was measured of its agent."""

    name: str
    namespace: str
    dialect: str
    row: SampleRow | None = None
    taken_mb_per_s: float | None = None
    alone: dict[str, float] = field(default_factory=dict)

    def told(self) -> dict[str, Any]:
        """For summary.json."""
        row = self.row
        return {
            "name": self.name,
            "dialect": self.dialect,
            "verified": row is not None and row.located and row.verified,
            "position_error_m": None if row is None else row.position_error_m,
            "rotation_error_deg": None if row is None else row.rotation_error_deg,
            "agent_mb_per_s": self.taken_mb_per_s,
            **{f"alone_{name}": value for name, value in self.alone.items()},
        }


def run(options: RosOptions, out: Path) -> dict[str, Any]:
    """Runs the fleet, then each robot's frames alone; returns the summary.

    Raises:
        FleetPoseError: a dialect is none, or a process ended.
    """
    dialects = options.dialect or DIALECTS
    if strange := set(dialects) - set(DIALECTS):
        raise FleetPoseError(f"--dialect {sorted(strange)[0]}: give {', '.join(DIALECTS)}")
    logs = output.output_folder(out) / "logs"
    for old in logs.glob("*"):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch, LocalFleet(logs) as fleet:
        robots, truth = _stand_ins(fleet, dialects, options.seed)
        first_pose_s = _live(fleet, robots, truth, options, Path(scratch))
        for robot in robots:
            robot.alone = _alone(fleet, robot, options)
        fleet.close()
        leftover = fleet.leftover_processes()
    told = [robot.told() for robot in robots]
    summary = {
        "first_pose_s": first_pose_s,
        "mb_per_s_max": _most([one["agent_mb_per_s"] for one in told]),
        "core_percent_max": _most([one.get("alone_core_percent") for one in told]),
        "verified": sum(one["verified"] for one in told),
        "robots": told,
        "leftover_processes": leftover,
    }
    output.write_summary(out, summary)
    rows = [[one.get(column) for column in _COLUMNS.values()] for one in told]
    output.print_table("robots", tuple(_COLUMNS), rows)
    for line in bars(summary):
        print(line)
    return summary


def passed(summary: Mapping[str, Any]) -> bool:
    """Whether every bar is met."""
    return all(line.startswith("met") for line in bars(summary))


def bars(summary: Mapping[str, Any]) -> list[str]:
    """Each bar in a line, met or not."""
    robots = len(summary["robots"])
    return [
        _bar("first pose s", summary["first_pose_s"], FIRST_POSE_S),
        _bar("MB/s taken per agent", summary["mb_per_s_max"], MB_PER_S),
        _bar("percent of a core beyond view work", summary["core_percent_max"], CORE_PERCENT),
        f"{'met' if summary['verified'] == robots else 'not met':8} verified robots "
        f"{summary['verified']} of {robots}",
    ]


def _bar(what: str, value: float | None, most: float) -> str:
    met = value is not None and value <= most
    shown = "none" if value is None else f"{value:.2f}"
    return f"{'met' if met else 'not met':8} {what} {shown} <= {most:g}"


def _most(values: Sequence[float | None]) -> float | None:
    """The largest; None where one is missing."""
    return None if None in values else max(cast(Sequence[float], values))


def _stand_ins(
    fleet: LocalFleet, dialects: Sequence[str], seed: int
) -> tuple[list[Robot], StandingTruth]:
    fleet.start_router()
    module = "fleetpose.evaluation.system.ros.stand_in"
    fleet.start("stand-ins", module, fleet.endpoint, ",".join(dialects), str(seed), json_lines=True)
    if not wait_running(fleet, lambda: bool(fleet.told("stand-ins")), _UP_WITHIN_S):
        raise FleetPoseError(f"the stand-ins do not start; the logs are in {fleet.directory}")
    [told] = fleet.told("stand-ins")
    robots = [Robot(name_of(space), space, one["dialect"]) for space, one in told.items()]
    true = {name_of(space): np.array(one["T_world_robot"]) for space, one in told.items()}
    return robots, StandingTruth(true)


def _live(
    fleet: LocalFleet,
    robots: Sequence[Robot],
    truth: StandingTruth,
    options: RosOptions,
    scratch: Path,
) -> float | None:
    """With server and agents; returns when the first pose was there, s after the agents' start."""
    fleet.start_server("--workers", "2", state=scratch / "state")
    names = tuple(robot.name for robot in robots)
    with observed(fleet) as observer:
        if not wait_running(fleet, observer.server_alive, _UP_WITHIN_S):
            raise FleetPoseError(f"no server; the logs are in {fleet.directory}")
        started_s = time.monotonic()
        for robot in robots:
            _start_agent(fleet, robot, options.rate)
        wait_started(fleet, observer, len(robots))
        wait_running(fleet, lambda: False, started_s + options.seconds - time.monotonic())
        rows = _scored(observer, truth, names)
        first_s = observer.first_pose_s(names, started_s)
    for robot in robots:
        robot.row = rows.get(robot.name)
        robot.taken_mb_per_s = _taken(fleet, robot.name)
        fleet.stop(robot.name)
    fleet.stop("server")
    return None if first_s is None else first_s - started_s


def _start_agent(fleet: LocalFleet, robot: Robot, rate_hz: float) -> None:
    """Named by its namespace."""
    source = ("--camera", "ros", "--data", fleet.endpoint, "--namespace", robot.namespace)
    rate = ("--rate", str(rate_hz))
    module = "fleetpose.robot_agent"
    fleet.start(robot.name, module, "run", *fleet.connection, *source, *rate, nice=ROBOT_NICE)


def _scored(observer: Observer, truth: StandingTruth, names: Sequence[str]) -> dict[str, SampleRow]:
    anchor = None if observer.state is None else observer.state.anchor
    poses = poses_now(observer, cast(Truth, truth))
    return {row.robot: row for row in score_sample(0.0, names, poses, anchor)}


def _taken(fleet: LocalFleet, name: str) -> float | None:
    """Megabytes a second, of all that an agent said."""
    said = _TOOK.findall((fleet.directory / f"{name}.log").read_text(errors="replace"))
    return float(np.mean([float(rate) for _, rate in said])) if said else None


def _alone(fleet: LocalFleet, robot: Robot, options: RosOptions) -> dict[str, float]:
    name, module = f"{robot.name}-alone", "fleetpose.evaluation.system.ros.receiver"
    where = (fleet.endpoint, robot.namespace, str(options.cost_seconds), str(options.rate))
    fleet.start(name, module, *where, json_lines=True)
    within_s = options.cost_seconds + _UP_WITHIN_S
    wait_running(fleet, lambda: bool(fleet.told(name)), within_s)
    told = fleet.told(name)
    fleet.stop(name)
    return told[0] if told else {}
