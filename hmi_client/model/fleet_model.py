"""What a session knows: the server's word about the fleet, and the pictures of the robots.

No screen, no network, and no clock but the one given.
"""

from collections.abc import Callable

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.changes import Changes
from fleetpose.hmi_client.model.correspondence_model import CorrespondenceModel
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.image_buffer import ImageBuffer, Keeping
from fleetpose.hmi_client.model.matrix import natural
from fleetpose.hmi_client.model.records import Entry, Pair, Pick, Picture, new_events
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import (
    Alignment,
    CameraAnnouncement,
    FleetState,
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

MAX_PAIRS = 20_000
MAX_OPERATORS = 1_000  # names may be anybody's invention
FORGOTTEN_S = 16.0  # an operator's selection is told again at least three times until then
SILENT_S = 2.5  # the state comes at 2 to 5 Hz; after this long without it the server counts as gone


class FleetModel(Changes):
    """The state of a session; `on_...` takes what arrives.

    Args:
        operator: the operator's name, a chunk of keys.
        session: epoch of this life of the client; random if none is given.
        clock: monotonic seconds.
        kept: where updates are kept on disk until they are receipted.
    """

    def __init__(
        self,
        operator: str,
        session: str | None,
        clock: Callable[[], float],
        kept: UpdateLog | None = None,
    ) -> None:
        super().__init__(clock)
        self.fleet: FleetState | None = None
        self.status: ServerStatus | None = None
        self.versions: dict[str, str] = {}  # of the robots' software, "" before they told it
        self.pair: Pair | None = None
        self._book = CorrespondenceModel(operator, session, clock=clock, kept=kept)
        self._poses: dict[str, RobotPose] = {}
        self._alignments: dict[Pair, Alignment] = {}
        self._gallery = ImageBuffer()
        self._unreadable: dict[str, str] = {}
        self._fleet_s: float | None = None
        self._holding: tuple[ViewName, ViewName] | None = None
        self._depths: dict[ViewName, Depths] = {}
        self._others: dict[str, tuple[Selection, float]] = {}

    # ---- the fleet -------------------------------------------------------------------------------

    @property
    def silence_s(self) -> float:
        """Seconds since the server was last heard; infinite if never."""
        return float("inf") if self._fleet_s is None else self.clock() - self._fleet_s

    @property
    def silent(self) -> bool:
        """Whether the server counts as gone."""
        return self.silence_s > SILENT_S

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

    def newest_view(self, name: str) -> ViewName | None:
        """The newest view that the server has of a robot."""
        robots = self.fleet.robots if self.fleet else ()
        return next((r.newest_view for r in robots if r.robot == name), None)

    def poses(self) -> dict[str, RobotPose]:
        """The newest pose of every robot that has one."""
        with self._changed:
            return dict(self._poses)

    @property
    def alignment(self) -> Alignment | None:
        """The newest alignment of the selected pair."""
        return self._alignments.get(self.pair) if self.pair else None

    def alignments(self, robot: str) -> dict[Pair, Alignment]:
        """The newest alignment heard of each pair of a robot."""
        with self._changed:
            return {pair: known for pair, known in self._alignments.items() if robot in pair}

    def cell(self, pair: Pair) -> PairCell | None:
        """The matrix cell of a pair."""
        cells = self.fleet.pairs if self.fleet else ()
        return next((c for c in cells if (c.i, c.j) == pair), None)

    def question(self) -> Question | None:
        """The question about the selected pair if there is one, else the best one."""
        questions = self.fleet.questions if self.fleet else ()
        return next((q for q in questions if (q.i, q.j) == self.pair), next(iter(questions), None))

    def others(self) -> dict[Pair, tuple[str, ...]]:
        """Which other operators look at which pairs now."""
        with self._changed:
            found: dict[Pair, tuple[str, ...]] = {}
            for name, (selection, told_s) in sorted(self._others.items()):
                if selection.i and selection.j and self.clock() - told_s < FORGOTTEN_S:
                    pair = (selection.i, selection.j)
                    found[pair] = (*found.get(pair, ()), name)
            return found

    # ---- pictures --------------------------------------------------------------------------------

    def picture(self, robot: str) -> Picture | None:
        """The picture to show: the frozen one, else the newest whose view the server has taken.

        While no server is heard it is the newest of all; one cannot pick in it yet.
        """
        with self._changed:
            return self._gallery.shown(robot, self.silent)

    def picture_notice(self, robot: str) -> str:
        """Why the newest image of a robot is not shown; empty if it is."""
        with self._changed:
            reason = self._unreadable.get(robot)
            if reason is not None:
                return f"the image of {robot} cannot be read: {reason}"
            if self._gallery.shown(robot, self.silent) is None and self._gallery.waits(robot):
                return f"the server has not taken this view of {robot} yet"
            return ""

    @property
    def pictures_wait(self) -> bool:
        """Whether a picture of the pair is here of which the server has not told that it has it."""
        with self._changed:
            return any(self._gallery.waits(robot) for robot in self.pair or ())

    @property
    def frozen(self) -> bool:
        return self._gallery.frozen

    def keeping(self, robot: str) -> Keeping:
        """Whether the server keeps the frozen view of a robot; empty: not frozen, or just asked."""
        with self._changed:
            return self._gallery.keeping(robot)

    def frozen_views(self) -> tuple[ViewName, ...]:
        """The views that are held still, of robot i and j."""
        with self._changed:
            views = (self._gallery.frozen_view(robot) for robot in self.pair or ())
            return tuple(view for view in views if view is not None)

    def depths(self, robot: str) -> Depths | None:
        """Where the held picture of a robot has depth; none while that is not known."""
        with self._changed:
            view = self._gallery.frozen_view(robot)
            return self._depths.get(view) if view is not None else None

    def wanted_depths(self) -> tuple[ViewName, ...]:
        """The held views of which it is not known where they have depth."""
        return tuple(view for view in self.frozen_views() if view not in self._depths)

    def wanted_pictures(self) -> tuple[ViewName, ...]:
        """The views that are to be held as soon as their pictures are here."""
        with self._changed:
            views = self._holding or ()
            return tuple(view for view in views if self._gallery.find(view) is None)

    # ---- correspondences -------------------------------------------------------------------------

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

    @property
    def confirmed(self) -> int:
        """Number of the last update of this session that the server has receipted."""
        return self._book.outbox.confirmed

    @property
    def unconfirmed(self) -> int:
        """How many updates no receipt covers yet."""
        return len(self._book.outbox.open)

    # ---- feeding ---------------------------------------------------------------------------------

    def on_fleet(self, fleet: FleetState) -> None:
        """Takes the server's state; that of another server epoch replaces all that was known."""
        with self._changed:
            old = self.fleet
            same_server = old is not None and old.server_epoch == fleet.server_epoch
            if old is not None and same_server and fleet.n <= old.n:
                return
            if old is not None and not same_server:
                self._poses.clear()
                self._book.forget_other_servers(fleet.server_epoch)
                self._say("the server was started anew")
                self._bump("correspondences", "poses")
            anew = self.silent or not same_server
            self.fleet, self._fleet_s = fleet, self.clock()
            for robot in fleet.robots:
                if robot.pose is not None:
                    self._take_pose(robot.pose, again=True)  # the state tells how old it is now
                elif self._poses.pop(robot.robot, None):
                    self._bump("poses")
            self._follow_views(fleet, anew)
            self._say(*new_events(old.events if old and same_server else (), fleet.events))
            self._bump("fleet")

    def _follow_views(self, fleet: FleetState, anew: bool) -> None:
        newest = {r.robot: r.newest_view for r in fleet.robots if r.newest_view is not None}
        changed, lost = self._gallery.follow(newest, set(fleet.pinned), self.clock(), anew)
        for view in lost:
            self._say(
                f"the server does not keep view {view.seq} of {view.robot} any more: "
                "thaw (f) and pick in a newer image"
            )
        if changed or anew:  # without a server other pictures were shown
            self._bump("pictures", *(("selection",) if self.frozen else ()))

    def on_pose(self, pose: RobotPose) -> None:
        """Takes a pose unless a newer one of the same server is known."""
        with self._changed:
            self._take_pose(pose)

    def _take_pose(self, pose: RobotPose, again: bool = False) -> None:
        old = self._poses.get(pose.robot)
        epoch = self.fleet.server_epoch if self.fleet else pose.server_epoch
        if pose.server_epoch != epoch:
            return
        if old and old.server_epoch == epoch and pose.n < old.n + (not again):
            return
        self._poses[pose.robot] = pose
        if not old or (pose.n, pose.located) != (old.n, old.located):
            self._bump("poses")

    def on_alignment(self, alignment: Alignment) -> None:
        """Takes the newest alignment of a pair.

        Raises:
            CodecError: there are more pairs than any fleet has: names may be anybody's invention.
        """
        pair = (alignment.view_i.robot, alignment.view_j.robot)
        with self._changed:
            if pair not in self._alignments and len(self._alignments) >= MAX_PAIRS:
                raise CodecError(f"alignments of more than {MAX_PAIRS} pairs")
            self._alignments[pair] = alignment
            if pair == self.pair:
                self._bump("alignment")

    def on_status(self, status: ServerStatus) -> None:
        with self._changed:
            self.status = status
            self._bump("status")

    def on_camera(self, announcement: CameraAnnouncement) -> None:
        """Takes which version a robot runs."""
        with self._changed:
            self.versions[announcement.robot] = announcement.version
            self._bump("status")

    def on_selection(self, selection: Selection) -> None:
        """Takes what an operator looks at; one's own is known.

        Raises:
            CodecError: there are more operators than any fleet has.
        """
        name = selection.operator
        if name == self._book.operator:
            return
        with self._changed:
            known = self._others.get(name)
            if known is None and len(self._others) >= MAX_OPERATORS:
                raise CodecError(f"selections of more than {MAX_OPERATORS} operators")
            self._others[name] = selection, self.clock()
            before = known[0] if known else None
            if before is None or (before.i, before.j) != (selection.i, selection.j):
                self._bump("others")

    def on_picture(self, picture: Picture) -> None:
        """Takes a picture of a selected robot; it waits until the server has taken its view, and
        while frozen behind the frozen one.
        """
        with self._changed:
            readable_again = self._unreadable.pop(picture.view.robot, None) is not None
            if self._gallery.put(picture, self.clock()) or readable_again:
                self._bump("pictures", *(("selection",) if self.frozen else ()))

    def on_fetched(self, picture: Picture) -> None:
        """Takes the picture of a view that is to be held."""
        with self._changed:
            self._gallery.put_fetched(picture)
            self._hold_when_there()

    def on_not_fetched(self, view: ViewName, reason: str) -> None:
        """A view that is to be held cannot be had."""
        with self._changed:
            if self._holding is not None and view in self._holding:
                self._holding = None
                self._say(f"the image of {view.robot} of then cannot be had: {reason}")
                self._bump("selection", "pictures")

    def on_depths(self, depths: Depths) -> None:
        """Takes where a held picture has depth."""
        with self._changed:
            if depths.view in self.frozen_views():
                self._depths = {
                    view: known
                    for view, known in self._depths.items()
                    if view in self.frozen_views()
                } | {depths.view: depths}
                self._bump("depths")

    def _hold_when_there(self) -> None:
        """Holds the wanted views once both pictures are here."""
        pictures = [self._gallery.find(view) for view in self._holding or ()]
        there = [picture for picture in pictures if picture is not None]
        if len(there) == 2:
            self._holding = None
            self._gallery.hold(there, self.clock())
            self._bump("selection", "pictures")

    def on_unreadable(self, robot: str, reason: str, view: ViewName | None = None) -> None:
        """Notes that an image of a robot is none; `view` if it was taken for one before."""
        with self._changed:
            if view is not None:
                self._gallery.discard(view)
            self._unreadable[robot] = reason
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
                self._book.restart()
                self._say("the server has lost its journal: open updates are sent anew")
            settled = self._book.on_receipts(receipts)
            for ticket in settled:
                if ticket.reason is not None:
                    self._say(f"rejected: {ticket.reason}")
            self._bump("updates", "correspondences")
