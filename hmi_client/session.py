"""The operator's session: what is known and what the operator does.

No screen, no network, and no clock but the one given. Any thread may feed it and any thread may
command it. Screens poll `revisions()` at their own rate, so that a fast feed cannot flood a slow
terminal; other threads sleep in `wait_change`.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Literal, TypeVar

from hmi_client.errors import OperatorError
from hmi_client.gallery import Gallery
from hmi_client.matrix import natural
from hmi_client.model import Entry, HalfPick, Pair, Pick, Picture, PixelUV, new_events
from hmi_client.outbox import Ticket
from hmi_client.workbook import Workbook
from protocol.keys import checked_name, ordered_pair
from protocol.messages import (
    Alignment,
    FleetState,
    OperatorUpdate,
    PairCell,
    PairCorrespondences,
    Question,
    Receipts,
    RobotPose,
    RobotState,
    Selection,
    ServerStatus,
    ViewName,
)

Topic = (
    Literal["fleet", "poses", "alignment", "correspondences", "pictures"]
    | Literal["selection", "updates", "events", "status", "settings"]
)
T = TypeVar("T")


class OperatorSession:
    """State and commands of one operator.

    Args:
        operator: the operator's name, a chunk of keys.
        session: epoch of this life of the client; random if none is given.
        clock: monotonic seconds.
        threshold_m: errors above it are shown as a hyphen.
    """

    def __init__(
        self,
        operator: str,
        session: str | None = None,
        clock: Callable[[], float] = time.monotonic,
        threshold_m: float = 1.0,
    ) -> None:
        self.operator = checked_name(operator)
        self.clock = clock
        self.threshold_m = threshold_m
        self.fleet: FleetState | None = None
        self.status: ServerStatus | None = None
        self.alignment: Alignment | None = None
        self.pair: Pair | None = None
        self.half: HalfPick | None = None
        self.events: deque[str] = deque(maxlen=50)
        self._events_said = 0
        self._book = Workbook(self.operator, session)
        self._poses: dict[str, RobotPose] = {}
        self._gallery = Gallery()
        self._fleet_s: float | None = None
        self._selected_s = clock()
        self._revisions: Counter[str] = Counter()
        self._changed = threading.Condition(threading.RLock())

    def revisions(self) -> dict[str, int]:
        """A number per topic that grows with every change; a topic without is at 0."""
        with self._changed:
            return dict(self._revisions)

    def wait_change(
        self, seen: dict[str, int], topics: tuple[Topic, ...], timeout_s: float
    ) -> bool:
        """Sleeps until one of the topics is newer than seen; whether it is."""
        with self._changed:
            return self._changed.wait_for(
                lambda: any(self._revisions[t] != seen.get(t, 0) for t in topics), timeout_s
            )

    @property
    def silence_s(self) -> float:
        """Seconds since the server was last heard; infinite if never."""
        return float("inf") if self._fleet_s is None else self.clock() - self._fleet_s

    @property
    def seconds_selected(self) -> float:
        """How long the present pair has been selected."""
        return self.clock() - self._selected_s

    def robots(self) -> list[str]:
        """Names of all robots, in natural order (r2 before r10)."""
        fleet = self.fleet
        return sorted((r.robot for r in fleet.robots), key=natural) if fleet else []

    def robot(self, name: str) -> RobotState:
        """A robot's state.

        Raises:
            OperatorError: the fleet has no such robot; the sentence names those it has.
        """
        for state in self.fleet.robots if self.fleet else ():
            if state.robot == name:
                return state
        known = ", ".join(self.robots()) or "none"
        raise OperatorError(f"no robot '{name}' in this fleet; known robots: {known}")

    def poses(self) -> dict[str, RobotPose]:
        """The newest pose of every robot that has one."""
        with self._changed:
            return dict(self._poses)

    def cell(self, pair: Pair) -> PairCell | None:
        """The matrix cell of a pair."""
        cells = self.fleet.pairs if self.fleet else ()
        return next((c for c in cells if (c.i, c.j) == pair), None)

    def question(self) -> Question | None:
        """The question about the selected pair if there is one, else the best one."""
        questions = self.fleet.questions if self.fleet else ()
        return next((q for q in questions if (q.i, q.j) == self.pair), next(iter(questions), None))

    def picture(self, robot: str) -> Picture | None:
        """The picture to show and to pick in: the frozen one, else the newest."""
        with self._changed:
            return self._gallery.shown(robot)

    @property
    def frozen(self) -> bool:
        return self._gallery.frozen

    def entries(self, pair: Pair | None = None) -> list[Entry]:
        """The list of a pair (default: the selected one), open and rejected ones included."""
        pair = pair or self.pair
        with self._changed:
            return self._book.entries(pair) if pair else []

    def sets(self) -> dict[Pair, PairCorrespondences]:
        """The server's sets of correspondences, as far as it has told them."""
        with self._changed:
            return dict(self._book.sets)

    def find(self, pick: Pick | None) -> int | None:
        """The server's id of exactly this pick; none while no set shows it."""
        with self._changed:
            found = self._book.find(pick) if pick else None
            return found.id if found else None

    def events_since(self, count: int) -> tuple[list[str], int]:
        """Events after the first `count` ever, as far as they are kept, and how many there were."""
        with self._changed:
            fresh = min(self._events_said - count, len(self.events))
            return list(self.events)[len(self.events) - fresh :], self._events_said

    @property
    def confirmed(self) -> int:
        """Number of the last update of this session that the server has receipted."""
        return self._book.outbox.confirmed

    # ---- feeding ---------------------------------------------------------------------------------

    def on_fleet(self, fleet: FleetState) -> None:
        """Takes the server's state; that of another server epoch replaces all that was known."""
        with self._changed:
            old = self.fleet
            if old and old.server_epoch == fleet.server_epoch and fleet.n <= old.n:
                return
            if old and old.server_epoch != fleet.server_epoch:
                self._poses.clear()
                self._book.forget_other_servers(fleet.server_epoch)
                self._say("the server was started anew")
                self._bump("correspondences", "poses")
            self.fleet, self._fleet_s = fleet, self.clock()
            for robot in fleet.robots:
                if robot.pose is not None:
                    self.on_pose(robot.pose)
                elif self._poses.pop(robot.robot, None):
                    self._bump("poses")
            same_server = old is not None and old.server_epoch == fleet.server_epoch
            fresh = new_events(old.events if old and same_server else (), fleet.events)
            self._say(*fresh)
            self._bump("fleet")

    def on_pose(self, pose: RobotPose) -> None:
        """Takes a pose unless a newer one of the same server is known."""
        with self._changed:
            old = self._poses.get(pose.robot)
            epoch = self.fleet.server_epoch if self.fleet else pose.server_epoch
            if pose.server_epoch != epoch or (
                old and old.server_epoch == epoch and pose.n <= old.n
            ):
                return
            self._poses[pose.robot] = pose
            self._bump("poses")

    def on_alignment(self, alignment: Alignment) -> None:
        """Takes the newest alignment if it is of the selected pair."""
        with self._changed:
            if (alignment.view_i.robot, alignment.view_j.robot) == self.pair:
                self.alignment = alignment
                self._bump("alignment")

    def on_status(self, status: ServerStatus) -> None:
        with self._changed:
            self.status = status
            self._bump("status")

    def on_picture(self, picture: Picture) -> None:
        """Takes a picture of a selected robot; while frozen it waits behind the frozen one."""
        with self._changed:
            if self._gallery.put(picture):
                self._bump("pictures", *(("selection",) if self.frozen else ()))

    def on_correspondences(self, known: PairCorrespondences) -> None:
        """Takes the server's set of a pair."""
        with self._changed:
            if self._book.on_set(known):
                self._bump("correspondences", "updates")

    def on_receipts(self, receipts: Receipts) -> None:
        """Takes cumulative receipts; rejections are told as events and stay in the list."""
        with self._changed:
            current = self.fleet is not None and self.fleet.server_epoch == receipts.server_epoch
            if current and self._book.outbox.is_forgotten_by(receipts):
                self._book.outbox.restart()
                self._say("the server has lost its journal: open updates are sent anew")
            settled = self._book.on_receipts(receipts)
            for ticket in settled:
                if ticket.reason is not None:
                    self._say(f"rejected: {ticket.reason}")
            self._bump("updates", "correspondences")

    # ---- commands: what to look at ---------------------------------------------------------------

    def select(self, a: str, b: str) -> None:
        """Selects two robots in either order; a half pick of another pair is dropped."""
        if a == b:
            raise OperatorError(f"'{a}' and '{b}' are one robot; a pair needs two")
        for name in (a, b):
            self.robot(name)
        with self._changed:
            pair = ordered_pair(a, b)
            if pair == self.pair:
                return
            self.pair, self.half, self.alignment = pair, None, None
            self._selected_s = self.clock()
            self._gallery.show(pair, self._selected_s)
            self._bump("selection", "pictures", "correspondences", "alignment")

    def next_question(self, step: int = 1) -> bool:
        """Selects the next question of the ranking (-1: the previous); false if none is asked."""
        questions = self.fleet.questions if self.fleet else ()
        if not questions:
            return False
        pairs = [(q.i, q.j) for q in questions]
        at = pairs.index(self.pair) + step if self.pair in pairs else 0
        self.select(*pairs[at % len(pairs)])
        return True

    def set_threshold(self, threshold_m: float) -> None:
        """Errors above it are hidden behind a hyphen; metres, above 0."""
        with self._changed:
            self.threshold_m = min(max(threshold_m, 1e-4), 1e4)
            self._bump("settings")

    def toggle_freeze(self) -> None:
        """Holds both pictures until called again, also over several picks."""
        with self._changed:
            gallery = self._gallery
            gallery.held = not gallery.held
            if gallery.held:
                gallery.freeze()
            elif self.half is None:
                gallery.thaw()
            self._bump("selection", "pictures")

    # ---- commands: correspondences -------------------------------------------------------------

    def pick(self, side: int, pixel: PixelUV) -> Ticket | None:
        """Picks in the picture of robot i (side 0) or j (side 1).

        The first pick freezes both pictures, since a correspondence belongs to two moments; a
        second one in the same picture moves it; one in the other picture completes it.

        Returns:
            The ticket of the completed correspondence, none after the first half.

        Raises:
            OperatorError: no pair is selected, or the picture is not there yet.
        """
        with self._changed:
            if self.pair is None:
                raise OperatorError("select two robots first: n, or Enter in the matrix")
            picture = self.picture(self.pair[side])
            if picture is None:
                raise OperatorError(f"the image of {self.pair[side]} has not arrived yet")
            this = HalfPick(side, picture.view, pixel)
            if self.half is None or self.half.side == side:
                self._gallery.freeze()
                self.half = this
                self._bump("selection")
                return None
            other = self.half
            self.half = None
            ticket = self.add(other.view, other.pixel, this.view, this.pixel)
            self._release()
            return ticket

    def cancel(self) -> bool:
        """Drops a half pick and dismisses rejections; whether there was anything to cancel."""
        with self._changed:
            dismissed = self.pair is not None and self._book.dismiss(self.pair)
            if self.half is None:
                self._bump("correspondences")
                return dismissed
            self.half = None
            self._release()
            return True

    def add(self, view_a: ViewName, pixel_a: PixelUV, view_b: ViewName, pixel_b: PixelUV) -> Ticket:
        """Adds a correspondence between two views, in either order."""
        return self._do(lambda: self._book.add(view_a, pixel_a, view_b, pixel_b))

    def erase(self, pair: Pair, id: int) -> Ticket:
        """Erases a correspondence of the server's set.

        Raises:
            OperatorError: the set has no such correspondence.
        """
        return self._do(lambda: self._book.erase(pair, id))

    def clear(self, pair: Pair) -> Ticket | None:
        """Erases all correspondences of a pair; none if it has none."""
        return self._do(lambda: self._book.clear(pair))

    def undo(self) -> bool:
        """Takes back the operator's last step; the first undo drops a half pick."""
        with self._changed:
            if self.half is not None:
                return self.cancel()
            return self._do(self._book.undo)

    def redo(self) -> bool:
        """Does again what was undone last."""
        return self._do(self._book.redo)

    # ---- what is to be sent ----------------------------------------------------------------------

    def open_updates(self) -> tuple[OperatorUpdate, ...]:
        """Updates that no receipt covers, in order; they are offered until one does."""
        with self._changed:
            return tuple(ticket.update for ticket in self._book.outbox.open)

    def selection(self) -> Selection:
        """The selected pair and, while frozen, the views that the server has to keep."""
        with self._changed:
            i, j = self.pair or (None, None)
            return Selection(
                operator=self.operator,
                session=self._book.outbox.session,
                i=i,
                j=j,
                view_i=self._gallery.frozen_view(i),
                view_j=self._gallery.frozen_view(j),
            )

    # ---- inside ----------------------------------------------------------------------------------

    def _do(self, deed: Callable[[], T]) -> T:
        with self._changed:
            done = deed()
            self._bump("updates", "correspondences")
            return done

    def _release(self) -> None:
        if not self._gallery.held:
            self._gallery.thaw()
        self._bump("selection", "pictures")

    def _say(self, *sentences: str) -> None:
        self.events.extend(sentences)
        self._events_said += len(sentences)
        if sentences:
            self._bump("events")

    def _bump(self, *topics: Topic) -> None:
        for topic in topics:
            self._revisions[topic] += 1
        self._changed.notify_all()
