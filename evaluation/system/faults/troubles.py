"""Faults that begin while a fleet stands located, and what the evaluation does for them.

Each is set off when all robots are located; some are over after half of the time.
"""

import os
import signal
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.metrics.geometry import Floats, rigid
from fleetpose.evaluation.system.faults.troubled import CLOCK_BACK_S
from fleetpose.evaluation.system.fleet import FleetPlan, RobotPlan, plan_world, start_robot
from fleetpose.evaluation.system.observer import Believed, Observer, SeenPose, SeenView
from fleetpose.evaluation.system.truth import Truth, WorldTruth
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RobotPose, ViewName
from fleetpose.protocol.transport import Link, Publisher, SessionSettings
from fleetpose.robot_agent.client import FleetRobot

FAULTY = "r2"
FORGED_EPOCH = "badbadbadbad"
_FORGED_M = 100.0
_OTHER_SEED = 1
_UP_WITHIN_S = 60.0


def places_for(robots: int) -> int:
    """How many places a world needs for so many robots, and as many for robots that are away."""
    return 2 * robots


class Trouble:
    """A fault that begins at some time; this one never does, and others say what is otherwise.

    Args:
        fleet: the running processes.
        plan: of the fleet's robots.
        observer: what is heard of them.
        link: the evaluation's own session.
        scratch: for files; the world's truth is there.
    """

    ends = False  # whether it is over after half of the time

    def __init__(
        self, fleet: LocalFleet, plan: FleetPlan, observer: Observer, link: Link, scratch: Path
    ) -> None:
        self.fleet, self.plan, self.observer = fleet, plan, observer
        self.link, self.scratch = link, scratch

    @property
    def away(self) -> str:
        """A place across the ring, that sees nothing of what the robot with the fault sees."""
        return f"r{len(self.plan.robots) + 2}"

    def elsewhere(self, robot: RobotPlan, place: str) -> RobotPlan:
        """The same robot at another place of its world."""
        return replace(robot, data=f"{robot.data.rpartition('/')[0]}/{place}")

    def start(self, robot: RobotPlan) -> None:
        """Starts the robot that is to have the fault."""
        start_robot(self.fleet, robot)

    def begin(self) -> None:
        """Sets it off."""

    def end(self) -> None:
        """Puts it right."""

    def step(self) -> None:
        """Goes on with it; called a few times a second."""

    def named(self) -> list[str]:
        """What names it beside alarms and events."""
        return []

    @property
    def truth(self) -> Truth:
        return self.plan.truth

    @property
    def ahead_ns(self) -> dict[str, int]:
        """By how much the clocks of robots are ahead now."""
        return {}

    def poses(self) -> Believed:
        """The poses that somebody acts on."""
        return self.observer

    def close(self) -> None:
        """Lets go of what it holds."""


class Signalled(Trouble):
    """A robot of `faults.troubled`, told by a signal; it tells what is true of it."""

    kind = ""

    def start(self, robot: RobotPlan) -> None:
        sources = [robot.data, self.elsewhere(robot, self.away).data]
        arguments = (robot.name, self.fleet.endpoint, self.fleet.site, str(robot.rate_hz), *sources)
        module = "fleetpose.evaluation.system.faults.troubled"
        self.fleet.start(robot.name, module, self.kind, *arguments, nice=10, json_lines=True)

    def begin(self) -> None:
        os.kill(self.fleet.pid(FAULTY), signal.SIGUSR1)

    @property
    def truth(self) -> Truth:
        return ToldTruth(self.plan.truth, self.scratch / "truth", self.fleet.told(FAULTY))


class Frozen(Signalled):
    """The camera hands out one image for ever while the wheels drive."""

    kind = "frozen"


class Still(Signalled):
    """The camera sees only what moves with the robot while the wheels drive."""

    kind = "still"


class Kidnapped(Signalled):
    """The robot is carried to another place, and back."""

    kind, ends = "kidnapped", True

    def end(self) -> None:
        self.begin()


class ClockStep(Signalled):
    """The robot's clock is set back."""

    kind = "clock-step"
    _back = False

    def begin(self) -> None:
        super().begin()
        self._back = True

    @property
    def ahead_ns(self) -> dict[str, int]:
        return {FAULTY: -round(1e9 * CLOCK_BACK_S)} if self._back else {}


class Leave(Trouble):
    """A robot that others rely on leaves."""

    def begin(self) -> None:
        self.fleet.stop(FAULTY)


class CarriedOne(Trouble):
    """A robot is switched off, carried to another place, switched on there, and carried back so.

    It begins with the first view from there.
    """

    ends = True
    _lives: tuple[tuple[str, str], ...] = ()

    def begin(self) -> None:
        self._restart(self.away)

    def end(self) -> None:
        self._restart(FAULTY)

    @property
    def truth(self) -> Truth:
        return LifeTruth(self.plan.truth, self.scratch / "truth", dict(self._lives))

    def _restart(self, place: str) -> None:
        before = _seen_lives(self.observer)
        self.fleet.stop(FAULTY)
        robot = next(robot for robot in self.plan.robots if robot.name == FAULTY)
        start_robot(self.fleet, self.elsewhere(robot, place))
        new = _new_lives(self.fleet, self.observer, before)
        self._lives = (*self._lives, *((life, place) for life in new))


class Carried(Trouble):
    """The whole fleet is switched off, carried to another hall, and switched on there. It begins
    with the first view from there.
    """

    _there: FleetPlan | None = None
    _before: frozenset[str] = frozenset()

    def begin(self) -> None:
        self._before = _seen_lives(self.observer)
        for name in (*self.plan.names, "world"):
            self.fleet.stop(name)
        folder = self.scratch / "there"
        folder.mkdir()
        places = [f"r{k + 1}" for k in range(places_for(len(self.plan.robots)))]
        self._there = there = plan_world(places, folder, moving=False, seed=_OTHER_SEED)
        self.fleet.start("other world", "fleetpose.evaluation", *there.world)
        assert isinstance(there.truth, WorldTruth)
        _wait(self.fleet, there.truth.is_there, "the other world")
        for robot in there.robots[: len(self.plan.robots)]:
            start_robot(self.fleet, robot)
        _new_lives(self.fleet, self.observer, self._before)

    @property
    def truth(self) -> Truth:
        if self._there is None:
            return self.plan.truth
        return TwoHalls(self.plan.truth, self._there.truth, self._before)


class OldEpoch(Trouble):
    """Some process publishes poses under the epoch of another server; a robot's program listens."""

    def begin(self) -> None:
        keys = Keys(self.fleet.site)
        session = SessionSettings(connect=(self.fleet.endpoint,))
        self._robot = FleetRobot("listener", session, self.fleet.site)
        self._forged: list[tuple[Publisher, RobotPose]] = [
            (self.link.latched(keys.pose(name)), _forged(seen.pose))
            for name, seen in self.observer.poses().items()
        ]

    def step(self) -> None:
        for publisher, pose in self._forged:
            publisher.put(pack(pose), encoding_of(RobotPose))

    def named(self) -> list[str]:
        return [reason for reason in self._robot.drops.snapshot() if "server" in reason]

    def poses(self) -> "AsRobot":
        return AsRobot(self._robot, self.observer)

    def close(self) -> None:
        self._robot.close()


@dataclass(frozen=True)
class AsRobot:
    """What a robot's own program takes for true."""

    robot: FleetRobot
    observer: Observer

    def poses(self) -> dict[str, SeenPose]:
        return {name: SeenPose(pose, time.monotonic()) for name, pose in self.robot.poses().items()}

    def view(self, name: ViewName) -> SeenView | None:
        return self.observer.view(name)


class _OfPlaces:
    """Truth of robots that stand at other places of the world than they began at."""

    def __init__(self, base: Truth, truth_file: Path) -> None:
        self.base, self._file = base, truth_file

    @property
    def rgbd(self) -> bool:
        return self.base.rgbd

    def median_depth_m(self, seen: Iterable[SeenView]) -> float:
        return self.base.median_depth_m(seen)

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        return self.base.correspondences(i, j)

    def see_the_same(self, i: SeenView, j: SeenView) -> bool:
        return self.base.see_the_same(i, j)

    def at(self, place: str, seen: SeenView) -> Floats | None:
        """Where who stands at a place is."""
        return WorldTruth(self._file, {seen.view.name.robot: place}).T_world_robot(seen)


class ToldTruth(_OfPlaces):
    """With a robot that told of each of its frames where it was."""

    def __init__(self, base: Truth, truth_file: Path, told: list[dict[str, object]]) -> None:
        super().__init__(base, truth_file)
        self._told = {line["stamp_ns"]: line for line in told}

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        if seen.view.name.robot != FAULTY:
            return self.base.T_world_robot(seen)
        line = self._told.get(seen.view.stamp_ns)
        T = None if line is None else self.at(str(line["place"]), seen)
        if T is None or line is None:
            return None
        return T @ rigid(np.eye(3), np.array([float(str(line["driven_m"])), 0.0, 0.0]))


class LifeTruth(_OfPlaces):
    """With a robot that was elsewhere in some of its lives.

    Args:
        places: by the epoch of the life.
    """

    def __init__(self, base: Truth, truth_file: Path, places: dict[str, str]) -> None:
        super().__init__(base, truth_file)
        self._places = places

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        place = self._places.get(seen.view.name.epoch)
        return self.base.T_world_robot(seen) if place is None else self.at(place, seen)


class TwoHalls(_OfPlaces):
    """Truth of one hall for some lives, and of another one for those that began later."""

    def __init__(self, base: Truth, there: Truth, before: frozenset[str]) -> None:
        super().__init__(there, Path())
        self._here, self._before = base, before

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        here = seen.view.name.epoch in self._before
        return (self._here if here else self.base).T_world_robot(seen)


def _forged(pose: RobotPose) -> RobotPose:
    """The same pose, far away, by a server that is not there."""
    T = pose.T_fleet_robot.copy()
    T[:3, 3] += _FORGED_M
    update = {
        "T_fleet_robot": T,
        "server_epoch": FORGED_EPOCH,
        "n": 2**40,
        "valid_until_ns": pose.valid_until_ns + 3600 * 10**9,
    }
    return pose.model_copy(update=update)


def _seen_lives(observer: Observer) -> frozenset[str]:
    """Epochs of which a view has arrived last."""
    return frozenset(seen.view.name.epoch for seen in observer.newest_views())


def _new_lives(fleet: LocalFleet, observer: Observer, before: frozenset[str]) -> frozenset[str]:
    """Waits for a view of a life that was not there before; those lives."""
    _wait(fleet, lambda: bool(_seen_lives(observer) - before), "a view from elsewhere")
    return _seen_lives(observer) - before


def _wait(fleet: LocalFleet, condition: Callable[[], bool], what: str) -> None:
    if not wait_running(fleet, condition, _UP_WITHIN_S):
        raise FleetPoseError(f"{what} is not there after {_UP_WITHIN_S:.0f} s")
