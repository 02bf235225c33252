"""`pose-eval tutor`: the other side of `hmi-client tutor`.

It tells lines of JSON on standard output: `step` while a lesson is made, `ready` once the learner's
client may come, `joined` when nothing is left to do, `report` at the end; `error` in place of any.
It goes on until its standard input is closed.
"""

import json
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.report.output import finite
from fleetpose.evaluation.system.fleet import observed
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.tutor.learner import Learner, Standing
from fleetpose.evaluation.system.tutor.lesson import APART, lesson_in, pairs_across
from fleetpose.evaluation.system.tutor.robots import Robots, robots_in
from fleetpose.evaluation.system.tutor.truths import ExactTruth, FinalPoses, Truth, truth_beside
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recording

SITE = "tutor"
STARTED_WITHIN_S = 150.0  # on a machine that is busy as well
JOINED_FOR_S = 10.0  # all are located and nothing was clicked
SETTLED_S, SETTLE_WITHIN_S = 2.0, 8.0  # after the last point, for what it does
_LOOK_S = 0.05

Say = Callable[[str, Any], None]


@dataclass(frozen=True)
class Plan:
    """What is played.

    Attributes:
        recording: of a site.
        robots: of it, with images.
        apart: robots that the machine may not join to the others.
        truth: what points are held against.
        speed: times as fast.
    """

    recording: Recording
    robots: tuple[str, ...]
    apart: tuple[str, ...]
    truth: Truth
    speed: float

    @classmethod
    def of(cls, file: Path, apart: tuple[str, ...], speed: float) -> "Plan":
        """Of a recording, with the truth beside it if there is one.

        Raises:
            FleetPoseError: it cannot be read, or has no such robots.
        """
        recording, robots = robots_in(file)
        if unknown := sorted(set(apart) - set(robots)):
            raise FleetPoseError(
                f"--apart {','.join(apart)}: {file} has no {', '.join(unknown)}; it has "
                f"{', '.join(robots)}"
            )
        if apart and set(apart) == set(robots):
            raise FleetPoseError(f"--apart {','.join(apart)}: name some of the robots, not all")
        beside = truth_beside(file)
        truth = ExactTruth.read(beside) if beside.exists() else FinalPoses.of(recording)
        return cls(recording, robots, apart, truth, speed)


def run(file: Path | None, keep: Path, apart: tuple[str, ...], speed: float) -> None:
    """Runs a lesson until standard input is closed, and says what came of it.

    Args:
        file: a recording of a site; none: the built-in lesson.
        keep: where the built-in lesson is kept.
        apart: robots that the machine may not join; none: the built-in lesson's own.
        speed: of the recording, times as fast.
    """
    try:
        if file is None:
            file = lesson_in(keep, lambda step: say("step", asdict(step)))
            apart = apart or APART
        teach(Plan.of(file, apart, speed), say, _closed_input())
    except FleetPoseError as error:
        say("error", str(error))


def say(what: str, told: Any) -> None:
    """A line for the client."""
    print(json.dumps({what: finite(told)}, allow_nan=False), flush=True)


def _closed_input() -> threading.Event:
    """Set once standard input is closed, be it because the client is gone."""
    closed = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        closed.set()

    threading.Thread(name="tutor input", target=wait, daemon=True).start()
    return closed


def teach(plan: Plan, say: Say, leave: threading.Event) -> None:
    """Runs a recording as a live fleet until told to leave; says what the learner did to it.

    Raises:
        FleetPoseError: a process ended, or did not start.
    """
    with (
        tempfile.TemporaryDirectory(prefix="fleetpose-tutor-") as folder,
        _site(Path(folder), plan) as (fleet, observer),
    ):
        keys = Keys(SITE)
        with Robots(plan.recording, observer.link, keys, plan.speed) as robots:
            learner = Learner(observer, plan.truth, robots.recorded)
            _wait_up(fleet, observer, robots, leave)
            began = learner.standing()
            connect = {"connect": [fleet.endpoint], "site": fleet.site}
            say("ready", {**connect, "robots": plan.robots, "apart": plan.apart})
            _follow(fleet, plan, learner, robots, say, leave)
            report = _report(plan, learner, began)
    say("report", report)


@contextmanager
def _site(folder: Path, plan: Plan) -> Iterator[tuple[LocalFleet, Observer]]:
    """A router and a fresh server, and what is heard of them."""
    skip: tuple[str, ...] = ()
    if plan.apart:
        pairs = folder / "apart"
        lines = [f"{a} {b}\n" for a, b in pairs_across(plan.robots, plan.apart)]
        pairs.write_text("".join(lines))
        skip = ("--skip-pairs", str(pairs))
    workers = max(1, min(4, os.cpu_count() or 1))
    with LocalFleet(folder, SITE) as fleet:
        fleet.start_router()
        fleet.start_server("--workers", str(workers), *skip)
        with observed(fleet) as observer:
            yield fleet, observer


def _wait_up(fleet: LocalFleet, observer: Observer, robots: Robots, leave: threading.Event) -> None:
    def up() -> bool:
        robots.check()
        return leave.is_set() or (observer.server_alive() and observer.alive_robots() > 1)

    if not wait_running(fleet, up, STARTED_WITHIN_S):
        raise FleetPoseError(f"the server does not start; its log ends:\n{fleet.tail('server')}")


def _follow(
    fleet: LocalFleet,
    plan: Plan,
    learner: Learner,
    robots: Robots,
    say: Say,
    leave: threading.Event,
) -> None:
    """Looks until the learner leaves, and then until the last point has done what it does."""
    all_s, told = None, False
    while not leave.wait(_LOOK_S):
        fleet.check()
        robots.check()
        learner.look()
        whole = bool(learner.points) and learner.standing().located == len(plan.robots)
        all_s = (all_s or time.monotonic()) if whole else None
        waited = all_s is not None and time.monotonic() - all_s > JOINED_FOR_S
        if not told and waited and learner.settled_for_s > JOINED_FOR_S:
            say("joined", len(plan.robots))
            told = True
    if learner.points:
        wait_running(fleet, lambda: _settled(learner), SETTLE_WITHIN_S)
    learner.finish()


def _settled(learner: Learner) -> bool:
    learner.look()
    return learner.settled_for_s > SETTLED_S


def _report(plan: Plan, learner: Learner, began: Standing) -> dict[str, Any]:
    before = learner.points[0].before if learner.points else began
    return {
        "recording": plan.recording.path.name,
        "against": plan.truth.against,
        "robots": plan.robots,
        "apart": plan.apart,
        "before": asdict(before),
        "after": asdict(learner.standing()),
        "points": [point.told() for point in learner.points],
    }
