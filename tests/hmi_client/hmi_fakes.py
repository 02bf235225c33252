"""A small pose server with robots, for tests of the operator's clients, over real zenoh."""

import math
import threading
import time
from collections.abc import Callable

import numpy as np

from protocol.codec import encoding_of, pack, unpack
from protocol.keys import Keys, ordered_pair
from protocol.messages import (
    Camera,
    Correspondence,
    FleetState,
    ImageHeader,
    KeptView,
    NoiseModel,
    OperatorUpdate,
    PairCell,
    PairCorrespondences,
    Question,
    Receipts,
    Rejection,
    RobotPose,
    RobotState,
    Salient,
    ScatteredCloud,
    Selection,
    ServerStatus,
    View,
    ViewName,
)
from protocol.transport import Answer, Link, Sample, SessionSettings, Slots, open_session

EPOCH = "0123456789ab"
ROBOT_EPOCH = "a0b1c2d3e4f5"
NO_DEPTH_U = 600.0  # a click right of it is rejected


def view(robot: str, seq: int = 7) -> ViewName:
    return ViewName(robot=robot, epoch=ROBOT_EPOCH, seq=seq)


def pose(robot: str, x: float, y: float, heading: float = 0.0, **changes) -> RobotPose:
    c, s = math.cos(heading), math.sin(heading)
    T = np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    fields = {
        "robot": robot,
        "view": view(robot),
        "stamp_ns": 0,
        "T_fleet_robot": T,
        "covariance": np.diag([1e-6, 1e-6, 1e-5, 4e-4, 2e-4, 1e-4]),
        "component": "r1",
        "located": True,
        "verdict": "verified",
        "gauge_revision": 0,
        "jumped": False,
        "age_s": 0.3,
        "valid_until_ns": 5 * 10**9,
        "server_epoch": EPOCH,
        "n": 1,
    }
    return RobotPose(**(fields | changes))


def ring(count: int, seq: int = 7) -> tuple[RobotState, ...]:
    """Robots on an arc of 5 m radius; the last has no pose, the one before stands apart."""
    states = []
    for k in range(count):
        name = f"r{k + 1}"
        angle = 0.35 * k
        p = pose(name, 5 * math.sin(angle), 5 - 5 * math.cos(angle), angle, view=view(name, seq))
        why = ""
        if k and k == count - 1:
            p, why = None, "alive, but no pair of it could be aligned"
        elif k > 3 and k == count - 2:
            p = p.model_copy(update={"located": False, "component": name})
            why = "not joined to the anchor"
        states.append(
            RobotState(
                robot=name,
                alive=True,
                newest_view=view(name, seq),
                views_kept=5,
                pose=p,
                why_not=why,
            )
        )
    return tuple(states)


def cells_of(names: list[str]) -> tuple[PairCell, ...]:
    """Neighbours are aligned, the second next rejected or through others, the rest never tried."""
    cells = []
    for a in range(len(names)):
        for b in range(a + 1, len(names)):
            i, j = ordered_pair(names[a], names[b])
            gap = b - a
            if gap == 1:
                cell = PairCell(
                    i=i, j=j, state="tried", verdict="verified", rmse_m=0.01 * b, overlap=0.5
                )
            elif gap == 2:
                verdict = "plausible" if a % 2 else "rejected"
                cell = PairCell(i=i, j=j, state="tried", verdict=verdict, rmse_m=0.05 + 0.01 * b)
            elif gap == 3:
                cell = PairCell(i=i, j=j, state="through_others")
            else:
                cell = PairCell(i=i, j=j, state="untried")
            cells.append(cell)
    return tuple(cells)


def fleet(count: int = 6, n: int = 1, seq: int = 7, **changes) -> FleetState:
    robots = ring(count, seq)
    names = [r.robot for r in robots]
    questions = ()
    if count > 2:
        i, j = ordered_pair(names[-2], names[-1])
        reason = "it would join two parts of the fleet"
        questions = (
            Question(i=i, j=j, view_i=view(i), view_j=view(j), reason=reason, gain=0.42),
            Question(i="r1", j="r2", view_i=view("r1"), view_j=view("r2"), reason="weak", gain=0.1),
        )
    fields = {
        "server_epoch": EPOCH,
        "n": n,
        "stamp_ns": 0,
        "anchor": "r1" if count else None,
        "gauge_revision": 0,
        "up_assumed": False,
        "robots": robots,
        "pairs": cells_of(names),
        "questions": questions,
        "events": ("fleet solved with 4 robots",),
    }
    return FleetState(**(fields | changes))


class FakeServer:
    """Publishes the state at 5 Hz and pictures at 4 Hz, answers updates with receipts.

    Args:
        endpoint: of the router.
        count: robots.
        pictures: JPEG of a robot; none leaves the robots without images.
        live: publish images; if not, they are only given on request.
        mute: take updates, but never answer.
    """

    def __init__(
        self,
        endpoint: str,
        count: int = 6,
        pictures: Callable[[str, int], bytes] | None = None,
        live: bool = True,
        mute: bool = False,
    ) -> None:
        self.count, self.pictures, self.live, self.mute = count, pictures, live, mute
        self.updates: list[OperatorUpdate] = []
        self.selections: list[Selection] = []
        self.sets: dict[tuple[str, str], PairCorrespondences] = {}
        self._done: dict[str, int] = {}
        self._rejections: dict[str, list[Rejection]] = {}
        self._receipts: dict[str, object] = {}
        self._publishers: dict[tuple[str, str], object] = {}
        self._next_id = 1
        self._seq = 7
        self._stop = threading.Event()
        self.keys = Keys("demo")
        self.link = Link(open_session(SessionSettings(connect=(endpoint,))))
        self._inbox: list[Sample] = []
        self._changed = threading.Condition()
        self.link.on_latched(self.keys.updates("*"), self._store)
        self.link.on_latched(self.keys.selection("*"), self._store)
        self._state = self.link.latched(self.keys.state)
        self._status = self.link.latched(self.keys.status)
        robots = [r.robot for r in ring(count)]
        self._images = {r: self.link.bulk(self.keys.image(r)) for r in robots} if pictures else {}
        for robot in robots if pictures else ():
            self.link.queryable(
                self.keys.view(robot), lambda asked, r=robot: self._kept(r, int(asked["seq"]))
            )
        self._threads = [
            threading.Thread(target=self._publish, daemon=True),
            threading.Thread(target=self._answer, daemon=True),
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._stop.set()
        with self._changed:
            self._changed.notify_all()
        for thread in self._threads:
            thread.join(5.0)
        self.link.close()

    def image_wanted(self, robot: str) -> bool:
        return self._images[robot].wanted

    def _store(self, sample: Sample) -> None:
        with self._changed:
            self._inbox.append(sample)
            self._changed.notify_all()

    def _publish(self) -> None:
        for n in range(1, 10**6):
            state = fleet(self.count, n, self._seq)
            self._state.put(pack(state), encoding_of(FleetState))
            self._status.put(pack(status(n)), encoding_of(ServerStatus))
            if self.live:
                for robot, publisher in self._images.items():
                    if publisher.wanted:
                        header = ImageHeader(view=view(robot, self._seq), stamp_ns=0)
                        publisher.put(self.pictures(robot, self._seq), "image/jpeg", pack(header))
            if self._stop.wait(0.2):
                return
            self._seq += 1 if self.live and n % 5 == 0 else 0

    def _kept(self, robot: str, seq: int) -> Answer:
        kept = KeptView(
            view=empty_view(view(robot, seq)),
            jpeg=self.pictures(robot, seq),
            image=ImageHeader(view=view(robot, seq), stamp_ns=0),
        )
        return Answer(pack(kept), encoding_of(KeptView))

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
        done = self._done.get(update.session, 0)
        if self.mute or update.n > done + 1:
            return
        if update.n == done + 1:
            self._done[update.session] = update.n
            reason = self._apply(update)
            if reason:
                rejection = Rejection(n=update.n, reason=reason)
                self._rejections.setdefault(update.session, []).append(rejection)
        receipts = Receipts(
            operator=update.operator,
            session=update.session,
            n=self._done[update.session],
            rejections=tuple(self._rejections.get(update.session, ())[-100:]),
            server_epoch=EPOCH,
        )
        self._put(self.keys.receipts(update.operator), receipts)

    def _apply(self, update: OperatorUpdate) -> str | None:
        pair = (update.i, update.j)
        old = self.sets.get(pair)
        items = list(old.items) if old else []
        if update.action == "add":
            if max(update.pixel_i[0], update.pixel_j[0]) > NO_DEPTH_U:
                return "the pixel has no depth"
            items.append(
                Correspondence(
                    id=self._next_id,
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
            self._next_id += 1
        elif update.action == "erase":
            kept = [c for c in items if c.id != update.correspondence]
            if len(kept) == len(items):
                return f"no correspondence {update.correspondence}"
            items = kept
        else:
            items = []
        revision = old.revision + 1 if old else 1
        self.sets[pair] = PairCorrespondences(
            i=pair[0], j=pair[1], revision=revision, items=tuple(items), server_epoch=EPOCH
        )
        self._put(self.keys.correspondences(*pair), self.sets[pair])
        return None

    def _put(self, key: str, message) -> None:
        publisher = self._publishers.setdefault(key, self.link.latched(key))
        publisher.put(pack(message), encoding_of(type(message)))


def status(n: int = 1) -> ServerStatus:
    return ServerStatus(
        server_epoch=EPOCH,
        uptime_s=0.2 * n,
        views=10 * n,
        alignments=n,
        solves=n,
        pending_jobs=2,
        workers=2,
        pairs_per_s=3.5,
        other_cpu_ms_per_view=4.0,
        max_pair_wait_s=1.2,
        drops={"codec": 1},
        version="0.1.0",
    )


def empty_view(name: ViewName) -> View:
    camera = Camera(
        width=640,
        height=480,
        K=np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]),
        T_robot_camera=np.eye(4),
        noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.01)),
        kind="views",
    )
    cloud = ScatteredCloud(count=0, pixel_step_px=1 / 64, depth_step_m=0.001, data=b"")
    salient = Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=b"")
    return View(name=name, stamp_ns=0, camera=camera, cloud=cloud, salient=salient)


__all__ = ["FakeServer", "Slots", "fleet", "pose", "ring", "status", "view", "wait_for"]


def wait_for(condition: Callable[[], object], timeout_s: float = 10.0) -> None:
    """Polls until a condition holds; fails after the timeout."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "did not come true in time"
        time.sleep(0.02)
