"""`pose-eval operate`: a fleet in two pieces, joined by an operator at the keyboard."""

import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.metrics.scoring import pose_errors
from fleetpose.evaluation.options.fleets import OperateOptions
from fleetpose.evaluation.report.output import output_folder, write_summary
from fleetpose.evaluation.system.fleet import (
    FleetPlan,
    kept_apart,
    observed,
    plan_fleet,
    start,
    wait_started,
)
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.terminal.fingers import Fingers
from fleetpose.evaluation.system.terminal.interruption import Interruption
from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import Alignment, PairCorrespondences
from fleetpose.protocol.transport import Sample

SETTLE_S = 40.0  # for the machine to find what it can by itself
ANSWER_S = 20.0  # from the last click to the joined fleet
OK_SHARE, OK_DEG = 0.02, 2.0


@dataclass
class _Told:
    """The newest alignment and set of correspondences of each pair, as they come."""

    newest: dict[tuple[str, str], Alignment] = field(default_factory=dict)
    sets: dict[tuple[str, str], PairCorrespondences] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def store(self, sample: Sample) -> None:
        """Takes an alignment."""
        alignment = unpack(Alignment, sample.payload, sample.encoding)
        with self.lock:
            self.newest[alignment.view_i.robot, alignment.view_j.robot] = alignment

    def store_set(self, sample: Sample) -> None:
        """Takes a set of correspondences."""
        known = unpack(PairCorrespondences, sample.payload, sample.encoding)
        with self.lock:
            self.sets[known.i, known.j] = known

    def is_aligned(self, pair: tuple[str, str]) -> bool:
        """Whether the newest alignment of a pair says where it is."""
        alignment = self.of(pair)
        return alignment is not None and alignment.T_i_j is not None

    def clicks(self, pair: tuple[str, str]) -> int:
        """How many correspondences the server has of a pair."""
        with self.lock:
            return len(self.sets[pair].items) if pair in self.sets else 0

    def of(self, pair: tuple[str, str]) -> Alignment | None:
        with self.lock:
            return self.newest.get(pair)


def run(options: OperateOptions, out: Path) -> dict[str, Any]:
    """Starts a fleet whose last robot is kept from the automatic path, joins it by keys alone, and
    scores what became of it; writes the screens and summary.json.

    Raises:
        FleetPoseError: the data cannot be used, or the screen did not go on as it should.
    """
    of_fleet = options.of_fleet()
    of_fleet.in_metres()  # what cannot be is said before anything is made
    folder = output_folder(out)
    screens = folder / "screens"
    for old in screens.glob("*.txt"):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="fleetpose-") as scratch:
        plan = plan_fleet(of_fleet, Path(scratch))
        skip = kept_apart(plan.names, Path(scratch))
        shutil.rmtree(folder / "logs", ignore_errors=True)
        with LocalFleet(folder / "logs") as fleet:
            start(fleet, plan, 2, Path(scratch) / "state", skip)
            with observed(fleet) as observer:
                wait_started(fleet, observer, len(plan.robots))
                summary = _operated(fleet, plan, observer, options, screens)
    write_summary(folder, summary, "an operator at the keyboard")
    return summary


def _operated(
    fleet: LocalFleet,
    plan: FleetPlan,
    observer: Observer,
    options: OperateOptions,
    screens: Path,
) -> dict[str, Any]:
    told, keys = _Told(), observer.keys
    observer.link.on_latched(keys.alignment("*", "*"), told.store)
    observer.link.on_latched(keys.correspondences("*", "*"), told.store_set)
    last = plan.names[-1]
    if not wait_running(fleet, lambda: is_asked_about(observer, plan), SETTLE_S):
        raise FleetPoseError(f"after {SETTLE_S:.0f} s nothing is asked about the robot apart")
    client = ("-m", "fleetpose.hmi_client", "screen", *fleet.connection, "--operator", "fingers")
    command = [sys.executable, "-P", *client, "--theme", options.theme]
    state = {"XDG_STATE_HOME": str(fleet.directory / "client")}
    began_s = time.monotonic()
    with Terminal(command, *options.size, state) as terminal:
        terminal.wait_text("best question", 30.0)
        terminal.keep(screens, "start")
        killed = Interruption(fleet, terminal, screens) if options.kill_server else None
        fingers = Fingers(terminal, observer, plan.truth, screens, killed)
        by_hand = options.by_hand or options.kill_server
        pair = ordered_pair(*fingers.answer(options.points, by_hand))
        clicked_s = time.monotonic()
        joined = wait_running(fleet, lambda: is_joined(observer, last), ANSWER_S)
        joined_s = time.monotonic() - clicked_s
        kept = wait_running(fleet, lambda: told.clicks(pair) == len(fingers.picked), ANSWER_S)
        shown = joined and bool(terminal.wait(_is_told, "that it has joined"))
        terminal.keep(screens, "joined" if joined else "not-joined")
        pressed = terminal.keys
        seconds = time.monotonic() - began_s
    # the pose may overtake the alignment that it came from
    wait_running(fleet, lambda: told.is_aligned(pair), ANSWER_S)
    result = _judged(plan, observer, told, pair)
    return {
        "robots": len(plan.names),
        "points": len(fingers.picked),
        "by_suggestion": fingers.suggested,
        "keys": pressed,
        "seconds": round(seconds, 1),
        "joined": joined,
        "joined_s": round(joined_s, 2),
        "shown": shown,
        "lost": 0 if kept else len(fingers.picked) - told.clicks(pair),
        **({} if killed is None else killed.said()),
        **result,
    }


def is_asked_about(observer: Observer, plan: FleetPlan) -> bool:
    """Whether the other robots are together, and the first question is about the last one."""
    state = observer.state
    if state is None or not state.questions:
        return False
    question = state.questions[0]
    poses = [observer.poses().get(name) for name in plan.names[:-1]]
    together = all(pose is not None and pose.pose.located for pose in poses)
    return (together or len(poses) < 2) and plan.names[-1] in (question.i, question.j)


def _is_told(lines: Sequence[str]) -> bool:
    """Joined by the last point, or before it and now answered."""
    return any("joined" in line or "Answered" in line for line in lines)


def is_joined(observer: Observer, robot: str) -> bool:
    """Whether a robot is located."""
    seen = observer.poses().get(robot)
    return seen is not None and seen.pose.located


def _judged(
    plan: FleetPlan, observer: Observer, told: _Told, pair: tuple[str, str]
) -> dict[str, Any]:
    """The pair's alignment beside the truth (DESIGN 11)."""
    alignment = told.of(pair)
    seen = [observer.newest_view(robot) for robot in pair]
    nothing = {"verdict": None, "position_error_m": None, "rotation_error_deg": None, "ok": False}
    if alignment is None or alignment.T_i_j is None or seen[0] is None or seen[1] is None:
        return nothing
    T_world = [plan.truth.T_world_robot(one) for one in seen if one is not None]
    if T_world[0] is None or T_world[1] is None:
        return nothing
    cameras = [one.view.camera.T_robot_camera for one in seen if one is not None]
    T_true: Floats = inverse(T_world[0] @ cameras[0]) @ (T_world[1] @ cameras[1])
    off_m, off_deg = pose_errors(T_true, alignment.T_i_j)
    depth_m = plan.truth.median_depth_m(observer.newest_views())
    return {
        "verdict": alignment.verdict,
        "position_error_m": off_m,
        "rotation_error_deg": off_deg,
        "ok": off_m < OK_SHARE * depth_m and off_deg < OK_DEG,
    }
