"""`pose-eval demo`: a fleet in the synthetic world, with the operator's screen or without. Its last
robot is kept from the automatic path, so that there is a real question to answer.
"""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.metrics.fleet_scoring import SampleRow, score_sample
from fleetpose.evaluation.report.output import print_table
from fleetpose.evaluation.simulate.operator import SimulatedOperator
from fleetpose.evaluation.system.fleet import (
    FleetPlan,
    kept_apart,
    observed,
    plan_world,
    poses_now,
    start,
    wait_started,
)
from fleetpose.evaluation.system.observer import Observer, first_time_located
from fleetpose.evaluation.system.truth import WorldTruth
from fleetpose.protocol.errors import FleetPoseError

Face = Literal["text", "web", "none"]
FACES = {"text": "screen", "web": "web"}  # the client's commands
CLICKS_PER_MINUTE = 60.0
SETTLE_S = 5.0  # after all are located, so that the last alignments count
CLOSING_S = 6.0  # kept of the time for ending all processes
MAX_ERROR_SHARE = 0.01
"""The demo fails where the mean position error is above this share of the ring's radius."""


@dataclass(frozen=True)
class DemoResult:
    """How a demo without a screen ended."""

    rows: list[SampleRow]
    robots: int
    radius_m: float
    all_located_s: float | None

    @property
    def located(self) -> int:
        return sum(row.located for row in self.rows)

    @property
    def mean_error_m(self) -> float | None:
        """Mean over the located robots but the anchor."""
        errors = [
            row.position_error_m
            for row in self.rows
            if row.located and not row.is_anchor and row.position_error_m is not None
        ]
        return float(np.mean(errors)) if errors else None

    @property
    def good(self) -> bool:
        mean_m = self.mean_error_m
        return (
            self.located == self.robots
            and mean_m is not None
            and mean_m <= MAX_ERROR_SHARE * self.radius_m
        )


def run(robots: int, seconds: float, face: Face, pictures: Path | None = None) -> int:
    """Runs the demo; returns the exit code.

    Args:
        robots: how many.
        seconds: at most, without a face.
        face: what the operator sees; without one a simulated operator answers.
        pictures: folder for those of the documents, made on the way.
    """
    if robots < 2:
        raise FleetPoseError(f"--robots {robots}: a fleet has at least 2")
    began_s = time.monotonic()
    logs = Path(tempfile.mkdtemp(prefix="fleetpose-demo-"))
    plan = demo_plan(robots, logs)
    print(f"{robots} robots, a world, a server and a router; logs in {logs}", flush=True)
    print(
        f"the machine may not align {plan.names[-1]}: it waits for an operator's clicks", flush=True
    )
    with LocalFleet(logs) as fleet:
        start_demo(fleet, plan, logs)
        print(f"more screens: hmi-client {' '.join(fleet.connection)}", flush=True)
        if face != "none":
            return _by_hand(fleet, plan, face)
        result = _unattended(fleet, plan, began_s + seconds - CLOSING_S, pictures)
    return report(result, fleet.leftover_processes())


def demo_plan(robots: int, logs: Path) -> FleetPlan:
    """So many robots around a building; `logs` is the folder for what is true of them."""
    return plan_world([f"r{k + 1}" for k in range(robots)], logs, moving=False, seed=0)


def start_demo(fleet: LocalFleet, plan: FleetPlan, logs: Path) -> None:
    """Starts a demo's processes; its last robot is kept from the automatic path."""
    workers = max(1, min(4, os.cpu_count() or 1))
    start(fleet, plan, workers, logs / "state", kept_apart(plan.names, logs))


def without_screen(headless: bool) -> bool:
    """Whether there is no terminal to draw on, or none is wanted."""
    asked = headless or bool(os.environ.get("HEADLESS"))
    return asked or not (sys.stdin.isatty() and sys.stdout.isatty())


def _by_hand(fleet: LocalFleet, plan: FleetPlan, face: Face) -> int:
    """The operator's screen or page in the foreground; then how far off the robots ended."""
    with observed(fleet) as observer:
        code = _shown(fleet, FACES[face])
        rows = _sample(observer, plan)
    _print_errors(rows)
    return code


def _shown(fleet: LocalFleet, face: str) -> int:
    """Runs a face until it is left; the fleet ends with it."""
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", face, *fleet.connection]
    state = {"XDG_STATE_HOME": str(fleet.directory / face)}  # it ends with the fleet
    with subprocess.Popen(command, env={**os.environ, **state}) as screen:
        try:
            return screen.wait()
        except KeyboardInterrupt:  # how a page is left
            return 0
        finally:  # asked, not killed: it gives the terminal back as it was
            screen.terminate()


def _unattended(
    fleet: LocalFleet, plan: FleetPlan, deadline_s: float, pictures: Path | None
) -> DemoResult:
    """Waits until all robots are located; a simulated operator answers what is asked."""
    with observed(fleet) as observer, ExitStack() as closing:
        operator = SimulatedOperator(observer, plan.truth, CLICKS_PER_MINUTE, only_asked=True)
        closing.callback(operator.close)
        up_s = wait_started(fleet, observer, len(plan.robots))
        print("all processes are up", flush=True)
        if pictures is not None:  # of the moment before anybody answers
            others = len(plan.robots) - 1
            left_s = deadline_s - time.monotonic()
            wait_running(fleet, lambda: observer.located_counts[-1][1] >= others, left_s)
            screen = str(pictures / "screen.svg")
            _draw("hmi_client", "screenshot", "--out", screen, *fleet.connection)
        operator.start()
        if _watch_located(fleet, observer, len(plan.robots), deadline_s):
            wait_running(fleet, lambda: False, min(SETTLE_S, deadline_s - time.monotonic()))
            if pictures is not None:
                state = str(fleet.directory / "state")
                where = str(pictures / "map.png")
                _draw("pose_server", "export", "--picture", where, "--state-dir", state)
        rows = _last_sample(fleet, observer, plan, deadline_s)
        if operator.clicks:
            print(f"the simulated operator clicked {operator.clicks} times")
        all_located_s = first_time_located(observer.located_counts, len(plan.robots), up_s)
    assert isinstance(plan.truth, WorldTruth)
    return DemoResult(rows, len(plan.robots), plan.truth.radius_m(), all_located_s)


def _draw(package: str, *arguments: str) -> None:
    """Has a command of the project make a picture."""
    command = [sys.executable, "-P", "-m", f"fleetpose.{package}", *arguments]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)


def _last_sample(
    fleet: LocalFleet, observer: Observer, plan: FleetPlan, deadline_s: float
) -> list[SampleRow]:
    """The first moment at which all poses are fresh and located, else the last before the end."""
    rows: list[SampleRow] = []

    def all_located() -> bool:
        nonlocal rows
        rows = _sample(observer, plan)
        return all(row.located for row in rows)

    wait_running(fleet, all_located, max(deadline_s - time.monotonic(), 0.0))
    return rows


def _sample(observer: Observer, plan: FleetPlan) -> list[SampleRow]:
    """Where the robots are said to be, beside the truth, now."""
    anchor = None if observer.state is None else observer.state.anchor
    return score_sample(0.0, plan.names, poses_now(observer, plan.truth), anchor)


def _watch_located(fleet: LocalFleet, observer: Observer, robots: int, deadline_s: float) -> bool:
    """Prints how many robots are located whenever that changes; whether all were in time."""
    shown = 0
    first_pose_shown = False
    while time.monotonic() < deadline_s:
        now = observer.located_counts[-1][1]
        if not first_pose_shown and observer.poses():
            print("first pose", flush=True)
            first_pose_shown = True
        if now != shown:
            print(f"{now}/{robots} located", flush=True)
            shown = now
        if now == robots:
            return True
        wait_running(fleet, lambda: observer.located_counts[-1][1] != shown, 0.5)  # noqa: B023
    return False


def report(result: DemoResult, leftover_processes: int) -> int:
    """Prints how it went; returns the exit code."""
    _print_errors(result.rows)
    mean_m = result.mean_error_m
    if mean_m is not None:
        share = mean_m / result.radius_m
        print(f"mean error {mean_m:.4f} m: {share:.3%} of the ring's radius {result.radius_m:g} m")
    if result.all_located_s is not None:
        print(f"first full solution {result.all_located_s:.1f} s after the processes were up")
    if not result.good:
        print(
            f"not good: {result.located} of {result.robots} located; "
            f"the mean error may be {MAX_ERROR_SHARE:.0%} of the radius"
        )
    if leftover_processes:
        print(f"{leftover_processes} processes are left over")
    return 0 if result.good and not leftover_processes else 1


def _print_errors(rows: list[SampleRow]) -> None:
    print_table(
        "position errors against the truth; the origin counts as right",
        ("robot", "located", "error m", "error deg"),
        [
            (
                row.robot + (" (origin)" if row.is_anchor else ""),
                "yes" if row.located else "no",
                None if row.is_anchor else row.position_error_m,
                None if row.is_anchor else row.rotation_error_deg,
            )
            for row in rows
        ],
    )
