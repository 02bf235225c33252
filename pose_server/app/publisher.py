"""What the server tells, and when: poses that changed, alignments, correspondences, the fleet's
state at a steady rate.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.messages.builders import Stamp
from fleetpose.pose_server.messages.error_matrix import CellCache
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.keys import Keys, RobotPair
from fleetpose.protocol.messages import FleetState, OperatorUpdate, PairError, ViewName
from fleetpose.protocol.messages.base import Message

_STATE_SHARE = 0.05  # of the server's own thread that making the fleet's state may take
LONGEST_PAUSE_S = 1.0  # of the fleet's state, however long the last one took


@dataclass
class FleetPublisher:
    """Publishes what the server knows.

    Attributes:
        put: publishes a message under a key.
        epoch: of this server's life.
    """

    site: Site
    keys: Keys
    settings: ServerSettings
    epoch: str
    put: Callable[[str, Message], None]
    _numbers: dict[str, int] = field(default_factory=dict)
    _saw_newest: dict[str, object] = field(default_factory=dict)
    _saw_solution: object = None
    _errors: dict[str, tuple[PairError, ...]] = field(default_factory=dict)
    _cells: CellCache = field(default_factory=dict)

    def moved(self) -> None:
        """Poses of robots with a newer view, and of those that a solve moved or whose pair was
        aligned.
        """
        site = self.site
        solved = self._saw_solution is not site.solution
        self._saw_solution = site.solution
        for name in site.touched:
            self._errors.pop(name, None)
        touched = set() if site.dirty else site.touched  # what they led to is still to be solved
        for name, robot in site.robots.items():
            newest = robot.track.newest
            moved = name in touched or (solved and builders.has_moved(site, robot))
            if newest is None or (self._saw_newest.get(name) is newest and not moved):
                continue
            if name not in self._errors:
                self._errors[name] = builders.pair_errors(site, robot)
            found = builders.robot_pose(
                site, robot, self.settings, self.stamp(), self._errors[name]
            )
            if found is None:
                continue
            self._saw_newest[name] = newest
            robot.publish(*found)
            self.put(self.keys.pose(name), found[0])
        if not site.dirty:
            site.note_told()

    def alignment(self, i: ViewName, j: ViewName, result: PairResult) -> None:
        """An alignment of two robots' views."""
        n = self._count_up(f"{i.robot} {j.robot}")
        message = builders.alignment(i, j, result, self.stamp(), n)
        self.put(self.keys.alignment(i.robot, j.robot), message)

    def correspondences(self, pair: RobotPair) -> None:
        """A pair's whole set."""
        self.put(
            self.keys.correspondences(*pair), self.site.correspondences.message(*pair, self.epoch)
        )

    def receipts(self, update: OperatorUpdate) -> None:
        """What became of all updates of an operator's session so far."""
        receipts = self.site.correspondences.receipts(update, self.epoch)
        self.put(self.keys.receipts(update.operator), receipts)

    def state(self) -> float:
        """The fleet's state; returns for how many seconds none is worth its cost."""
        began_s = time.monotonic()
        state = builders.fleet_state(
            self.site, self.settings, self.stamp(), self._count_up("state"), self._cells
        )
        self.put(self.keys.state, state)
        self._tell_again(state)
        return pause_s(time.monotonic() - began_s)

    def _tell_again(self, state: FleetState) -> None:
        """Poses of robots that are not located any more, or are again, without a new view: who
        hears poses alone must hear that as well, and who comes late must not hear the old one.
        """
        for told in state.robots:
            robot = self.site.robots[told.robot]
            before, now = robot.published, told.pose
            if before is not None and now is not None and now.located != before.located:
                again = now.model_copy(update={"n": robot.poses_sent + 1, "jumped": False})
                robot.publish(again)
                self.put(self.keys.pose(robot.name), again)

    def stamp(self) -> Stamp:
        """This server, now."""
        return Stamp(self.epoch, time.monotonic(), time.time_ns())

    def _count_up(self, what: str) -> int:
        self._numbers[what] = self._numbers.get(what, 0) + 1
        return self._numbers[what]


def pause_s(took_s: float) -> float:
    """For how long no state follows one that took so long: it is to cost a share of the thread's
    time only, but a thread that was held up once has no reason to be silent for long.
    """
    return max(min(took_s / _STATE_SHARE, LONGEST_PAUSE_S) - took_s, 0.0)
