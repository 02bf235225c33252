"""A small pose server with robots, for tests of the operator's clients, over real zenoh."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from hmi_fakes import CAMERA, EPOCH, NO_DEPTH_U, ROBOT_EPOCH, empty_view, fleet, ring, status, view

from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Camera,
    CameraAnnouncement,
    Correspondence,
    FleetState,
    ImageHeader,
    KeptView,
    OperatorUpdate,
    PairCell,
    PairCorrespondences,
    Receipts,
    Rejection,
    Selection,
    ServerStatus,
    ViewName,
)
from fleetpose.protocol.transport import Answer, Link, Sample, SessionSettings, open_session


@dataclass
class Journal:
    """What outlives a server: give that of one to the next."""

    sets: dict[tuple[str, str], PairCorrespondences] = field(default_factory=dict)
    done: dict[str, int] = field(default_factory=dict)
    rejections: dict[str, list[Rejection]] = field(default_factory=dict)
    next_id: int = 1


class FakeServer:
    """Publishes the state at 5 Hz and pictures at 4 Hz, answers updates with receipts.

    Args:
        endpoint: of the router.
        count: robots.
        pictures: JPEG of a robot; none leaves the robots without images.
        live: publish images; if not, they are only given on request.
        mute: take updates, but never answer.
        epoch: of this life of the server.
        journal: what an earlier life has left.
        behind: how many views the server is behind the pictures.
        pins: whether it keeps the views of a selection.
        robots_forget: robots answer that they no longer keep a view.
        lose: this many receipts are lost on their way.
        camera: announced by each robot; none is not announced.
        site: of all its keys.
    """

    def __init__(
        self,
        endpoint: str,
        count: int = 6,
        pictures: Callable[[str, int], bytes] | None = None,
        live: bool = True,
        mute: bool = False,
        epoch: str = EPOCH,
        journal: Journal | None = None,
        behind: int = 0,
        pins: bool = True,
        robots_forget: bool = False,
        lose: int = 0,
        camera: Camera | None = CAMERA,
        site: str = "demo",
    ) -> None:
        self.count, self.pictures, self.live, self.mute = count, pictures, live, mute
        self.epoch, self.journal = epoch, journal or Journal()
        self.behind, self.pins, self.robots_forget, self.lose = behind, pins, robots_forget, lose
        self.updates: list[OperatorUpdate] = []
        self.selections: list[Selection] = []
        self._publishers: dict[tuple[str, str], object] = {}
        self._seq = 7
        self._stop = threading.Event()
        self.keys = Keys(site)
        self.link = Link(open_session(SessionSettings(connect=(endpoint,))))
        self.link.token(self.keys.server_alive(epoch))
        self._inbox: list[Sample] = []
        self._changed = threading.Condition()
        self.link.on_latched(self.keys.updates("*"), self._store)
        self.link.on_latched(self.keys.selection("*"), self._store)
        self.link.queryable(self.keys.server_view, self._clicked_view)
        self._state = self.link.latched(self.keys.state)
        self._status = self.link.latched(self.keys.status)
        robots = [r.robot for r in ring(count)]
        self._images = {r: self.link.bulk(self.keys.image(r)) for r in robots} if pictures else {}
        for robot in robots if pictures else ():
            self.link.queryable(
                self.keys.view(robot), lambda asked, r=robot: self._kept(r, int(asked["seq"]))
            )
            if camera is not None:
                self.announce(robot, camera)
        for known in self.sets.values():
            self._tell_set(known.model_copy(update={"server_epoch": epoch}))
        self._threads = [
            threading.Thread(target=self._publish, daemon=True),
            threading.Thread(target=self._answer, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def sets(self) -> dict[tuple[str, str], PairCorrespondences]:
        return self.journal.sets

    def close(self) -> None:
        if self._stop.is_set():
            return
        self._stop.set()
        with self._changed:
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(5.0)
        self.link.close()

    def image_wanted(self, robot: str) -> bool:
        return self._images[robot].wanted

    def announce(self, robot: str, camera: Camera) -> None:
        announcement = CameraAnnouncement(
            robot=robot, epoch=ROBOT_EPOCH, camera=camera, rate_hz=4.0
        )
        self.put(self.keys.camera(robot), announcement)

    def put(self, key: str, message) -> None:
        """Latches a message."""
        publisher = self._publishers.setdefault(key, self.link.latched(key))
        publisher.put(pack(message), encoding_of(type(message)))

    def _store(self, sample: Sample) -> None:
        with self._changed:
            self._inbox.append(sample)
            self._changed.notify_all()

    def _pinned(self) -> tuple[ViewName, ...]:
        newest = {s.operator: s for s in self.selections} if self.pins else {}
        return tuple(v for s in newest.values() for v in (s.view_i, s.view_j) if v is not None)

    def _publish(self) -> None:
        for n in range(1, 10**6):
            state = fleet(
                self.count,
                n,
                self._seq - self.behind,
                server_epoch=self.epoch,
                pinned=self._pinned(),
            )
            counted = state.model_copy(update={"pairs": tuple(map(self._counted, state.pairs))})
            self._state.put(pack(counted), encoding_of(FleetState))
            self._status.put(pack(status(n, self.epoch)), encoding_of(ServerStatus))
            if self.live:
                for robot, publisher in self._images.items():
                    if publisher.wanted:
                        header = ImageHeader(view=view(robot, self._seq), stamp_ns=0)
                        publisher.put(self.pictures(robot, self._seq), "image/jpeg", pack(header))
            if self._stop.wait(0.2):
                return
            self._seq += 1 if self.live and n % 5 == 0 else 0

    def _counted(self, cell: PairCell) -> PairCell:
        known = self.sets.get((cell.i, cell.j))
        return cell.model_copy(update={"correspondences": len(known.items) if known else 0})

    def _kept(self, robot: str, seq: int) -> Answer:
        if self.robots_forget:
            return Answer(error=f"view {seq} is not kept")
        kept = KeptView(
            view=empty_view(view(robot, seq)),
            jpeg=self.pictures(robot, seq),
            image=ImageHeader(view=view(robot, seq), stamp_ns=0),
        )
        return Answer(pack(kept), encoding_of(KeptView))

    def _clicked_view(self, asked: dict[str, str]) -> Answer:
        """A view that somebody clicked in."""
        name = ViewName(robot=asked["robot"], epoch=asked["epoch"], seq=int(asked["seq"]))
        clicked = {v for s in self.sets.values() for c in s.items for v in (c.view_i, c.view_j)}
        if name not in clicked:
            return Answer(error=f"nobody clicked in view {name}")
        jpeg = self.pictures(name.robot, name.seq)
        return Answer(pack(KeptView(view=empty_view(name), jpeg=jpeg)), encoding_of(KeptView))

    def _answer(self) -> None:
        while not self._stop.is_set():
            with self._changed:
                self._changed.wait_for(lambda: self._inbox or self._stop.is_set())
                samples, self._inbox = self._inbox, []
            for sample in samples:
                if sample.key.endswith("/selection"):
                    self.selections.append(unpack(Selection, sample.payload))
                else:
                    self._take(unpack(OperatorUpdate, sample.payload, sample.encoding))

    def _take(self, update: OperatorUpdate) -> None:
        self.updates.append(update)
        if self.mute:
            return
        done = self.journal.done.get(update.session, 0)
        if update.n == done + 1:
            self.journal.done[update.session] = update.n
            reason = self._apply(update)
            if reason:
                rejection = Rejection(n=update.n, reason=reason)
                self.journal.rejections.setdefault(update.session, []).append(rejection)
        if self.lose:
            self.lose -= 1
            return
        self.put(self.keys.receipts(update.operator), self.receipts(update))

    def receipts(self, update: OperatorUpdate) -> Receipts:
        """How far the session of an update has come; 0 for one that is not known."""
        return Receipts(
            operator=update.operator,
            session=update.session,
            n=self.journal.done.get(update.session, 0),
            rejections=tuple(self.journal.rejections.get(update.session, ())[-100:]),
            server_epoch=self.epoch,
        )

    def _apply(self, update: OperatorUpdate) -> str | None:
        """Works an update out; why it is rejected, if it is."""
        pair = (update.i, update.j)
        old = self.sets.get(pair)
        items = list(old.items) if old else []
        if update.action == "add":
            if max(update.pixel_i[0], update.pixel_j[0]) > NO_DEPTH_U:
                return "the pixel has no depth"
            items.append(
                Correspondence(
                    id=self.journal.next_id,
                    operator=update.operator,
                    view_i=update.view_i,
                    view_j=update.view_j,
                    pixel_i=update.pixel_i,
                    pixel_j=update.pixel_j,
                    status="accepted",
                    residual_m=0.012,
                    residual_px=0.8,
                )
            )
            self.journal.next_id += 1
        elif update.action == "erase":
            kept = [c for c in items if c.id != update.correspondence]
            if len(kept) == len(items):
                return f"no correspondence {update.correspondence}"
            items = kept
        else:
            if update.base_revision != (old.revision if old else 0):
                return "the set was changed meanwhile"
            items = []
        revision = old.revision + 1 if old else 1
        self.sets[pair] = PairCorrespondences(
            i=pair[0], j=pair[1], revision=revision, items=tuple(items), server_epoch=self.epoch
        )
        self._tell_set(self.sets[pair])
        return None

    def _tell_set(self, known: PairCorrespondences) -> None:
        self.put(self.keys.correspondences(known.i, known.j), known)
