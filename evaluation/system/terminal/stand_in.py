"""A server and robots that only say: load for the operator's client at rates that are known
exactly, and a note of what it sent.

Poses and errors of all robots change at each turn; images come of those robots that somebody
subscribes to.
"""

import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.simulate.replay_robots import stop_at_signals
from fleetpose.evaluation.simulate.world.materials.facades import Style, facade
from fleetpose.protocol import messages
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.keys import Keys, new_epoch
from fleetpose.protocol.messages import (
    FleetState,
    OperatorUpdate,
    PairCorrespondences,
    RobotPose,
    Selection,
    ViewName,
)
from fleetpose.protocol.transport import (
    ENCODING_JPEG,
    Answer,
    Link,
    Publisher,
    Sample,
    SessionSettings,
    open_session,
)

WIDTH, HEIGHT = 640, 480
JPEG_QUALITY = 92  # about 48 kB an image
NOISE_LEVELS = 2.0  # of a sensor, sigma
IMAGES = 40  # that are shown in turn
PAN_PX = 6  # per image of a moving camera
KEPT = 3  # clicks of a pair: the screen is not to drown in them
_APART_S, _PHASES = 0.025, 8  # robots do not take images at the same instant
_RING_M = 10.0

Image = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class Load:
    """How much is said.

    Attributes:
        robots: how many.
        state_hz: of poses and errors.
        image_hz: of each image that is wanted.
        moving: whether cameras pan; else they show the same, with a sensor's noise.
        points: correspondences that each pair gets once its views are held.
        questions: that are asked, two at most.
    """

    robots: int
    state_hz: float = 10.0
    image_hz: float = 5.0
    moving: bool = False
    points: int = 0
    questions: int = 2


def run(load: Load, connect: tuple[str, ...], site: str, notes: Path) -> None:
    """Says until SIGTERM or SIGINT; the operator's updates go to `notes`, a JSON line each."""
    stop = stop_at_signals()
    with contextlib.ExitStack() as links:

        def opened() -> Link:
            return links.enter_context(
                contextlib.closing(Link(open_session(SessionSettings(connect=connect))))
            )

        StandIn(opened(), (opened(), opened()), Keys(site), load, notes).run(stop)


def images(moving: bool, seed: int) -> list[bytes]:
    """JPEGs of a wall, shown forward and backward."""
    rng = np.random.default_rng(seed)
    reach = WIDTH + (PAN_PX * IMAGES if moving else 0)
    wall = facade(rng, reach / 100, HEIGHT / 100, 100.0, Style("brick"))
    shown = []
    for k in range(IMAGES):
        left = PAN_PX * k if moving else 0
        seen = wall[:HEIGHT, left : left + WIDTH] + rng.normal(0, NOISE_LEVELS, (HEIGHT, WIDTH, 3))
        image = np.clip(seen, 0, 255).astype(np.uint8)
        jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        shown.append(jpeg.tobytes())
    return shown + shown[-2:0:-1]


class StandIn:
    """Says what a server and its robots would say.

    Args:
        link: of the server.
        robots_links: of robots, in turn: an image of one must not be passed over because that of
            its neighbour is on its way, as it would be on one link.
        keys: of the site.
        load: how much is said.
        notes: file of the operator's updates.
    """

    def __init__(
        self, link: Link, robots_links: Sequence[Link], keys: Keys, load: Load, notes: Path
    ) -> None:
        self._link, self._keys, self._load, self._notes = link, keys, load, notes
        self._epoch, self._robot_epoch = new_epoch(), new_epoch()
        self._names = [f"r{k + 1}" for k in range(load.robots)]
        self._rng = np.random.default_rng(0)
        self._images = [images(load.moving, seed) for seed in (1, 2)]
        self._seq = 0
        self._due: list[tuple[float, int]] = []  # images of this turn, and when
        self._heard: deque[Sample] = deque()  # callbacks only store
        self._selected: Selection | None = None
        self._sets: dict[tuple[str, str], PairCorrespondences] = {}
        self._receipted: dict[str, int] = {}
        self._publishers: dict[str, Publisher] = {}
        link.token(keys.server_alive(self._epoch))
        self._states = link.latched(keys.state)
        self._poses = [link.latched(keys.pose(name)) for name in self._names]
        self._bulk = [
            robots_links[k % len(robots_links)].bulk(keys.image(name), background=True)
            for k, name in enumerate(self._names)
        ]
        for name in self._names:
            announced = messages.CameraAnnouncement(
                robot=name, epoch=self._robot_epoch, camera=CAMERA, rate_hz=load.image_hz
            )
            self._put(keys.camera(name), announced)
            link.queryable(keys.view(name), lambda asked, name=name: self._kept(name, asked))
        link.on_latched(keys.updates("*"), self._heard.append)
        link.on_latched(keys.selection("*"), self._heard.append)

    def run(self, stop: threading.Event) -> None:
        """Says until told to stop."""
        began_s, n = time.monotonic(), 0
        shown = 0
        while not stop.is_set():
            passed_s = time.monotonic() - began_s
            if passed_s >= shown / self._load.image_hz:
                self._seq += 1
                shown += 1
                self._due = [(passed_s + k % _PHASES * _APART_S, k) for k in range(len(self._bulk))]
            self._show(passed_s)
            if passed_s >= n / self._load.state_hz:
                self._tell(n)
                n += 1
            self._answer()
            stop.wait(0.005)

    # ---- saying ----------------------------------------------------------------------------------

    def _show(self, passed_s: float) -> None:
        due = [k for due_s, k in self._due if due_s <= passed_s]
        self._due = [(due_s, k) for due_s, k in self._due if due_s > passed_s]
        for k in due:
            publisher = self._bulk[k]
            if publisher.wanted:
                name = self._view(self._names[k])
                header = messages.ImageHeader(view=name, stamp_ns=time.time_ns())
                turn = self._images[k % 2]
                publisher.put(turn[self._seq % len(turn)], ENCODING_JPEG, pack(header))

    def _tell(self, n: int) -> None:
        poses = [self._pose(k, n) for k in range(self._load.robots)]
        for publisher, pose in zip(self._poses, poses, strict=True):
            publisher.put(pack(pose), encoding_of(RobotPose))
        selected = self._selected
        held = (selected.view_i, selected.view_j) if selected else ()
        state = FleetState(
            server_epoch=self._epoch,
            n=n,
            stamp_ns=time.time_ns(),
            anchor="r1",
            gauge_revision=0,
            up_assumed=False,
            robots=tuple(self._robot(pose) for pose in poses),
            pairs=self._cells(),
            questions=self._questions(),
            events=(f"turn {n // 50}",),
            pinned=tuple(view for view in held if view is not None),
        )
        self._states.put(pack(state), encoding_of(FleetState))

    def _view(self, robot: str) -> ViewName:
        return ViewName(robot=robot, epoch=self._robot_epoch, seq=self._seq)

    def _pose(self, k: int, n: int) -> RobotPose:
        angle = 2 * np.pi * k / self._load.robots
        drift = self._rng.normal(0, 0.02, 2)
        T = np.eye(4)
        T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
        T[:2, 3] = _RING_M * np.sin(angle) + drift[0], _RING_M * (1 - np.cos(angle)) + drift[1]
        return RobotPose(
            robot=self._names[k],
            view=self._view(self._names[k]),
            stamp_ns=time.time_ns(),
            T_fleet_robot=T,
            covariance=np.diag([1e-6, 1e-6, 1e-5, 4e-4, 2e-4, 1e-4]),
            component="r1",
            located=True,
            verdict="verified",
            gauge_revision=0,
            jumped=False,
            age_s=0.1,
            valid_until_ns=time.time_ns() + 5 * 10**9,
            server_epoch=self._epoch,
            n=n,
        )

    def _robot(self, pose: RobotPose) -> messages.RobotState:
        newest = pose.view
        return messages.RobotState(
            robot=pose.robot, alive=True, newest_view=newest, views_kept=30, pose=pose, why_not=""
        )

    def _cells(self) -> tuple[messages.PairCell, ...]:
        """Neighbours around the ring are aligned; the others are known through them."""
        cells = []
        for a, first in enumerate(self._names):
            for b in range(a + 1, len(self._names)):
                i, j = sorted((first, self._names[b]))
                apart = min(b - a, self._load.robots - (b - a))
                if apart > 4:
                    continue
                rmse_m = float(self._rng.uniform(0.01, 0.3))
                cells.append(
                    messages.PairCell(
                        i=i,
                        j=j,
                        state="tried",
                        verdict="verified" if apart < 3 else "plausible",
                        rmse_m=rmse_m,
                        regression_error_m2=100 * rmse_m**2,
                        regression_count=100,
                        overlap=1.0 / apart,
                        age_s=1.0,
                    )
                )
        return tuple(cells)

    def _questions(self) -> tuple[messages.Question, ...]:
        asked = []
        for a, b in (("r1", "r2"), ("r2", "r3"))[
            : min(self._load.questions, self._load.robots - 1)
        ]:
            why = "These two views are worth a click."
            view_a, view_b = self._view(a), self._view(b)
            asked.append(
                messages.Question(i=a, j=b, view_i=view_a, view_j=view_b, reason=why, gain=0.1)
            )
        return tuple(asked)

    # ---- hearing ---------------------------------------------------------------------------------

    def _answer(self) -> None:
        while self._heard:
            sample = self._heard.popleft()
            if sample.key.endswith("/selection"):
                self._selected = unpack(Selection, sample.payload, sample.encoding)
                self._fill(self._selected)
            else:
                self._take(unpack(OperatorUpdate, sample.payload, sample.encoding))

    def _take(self, update: OperatorUpdate) -> None:
        if update.n != self._receipted.get(update.session, 0) + 1:
            return
        self._receipted[update.session] = update.n
        record = {
            **{name: getattr(update, name) for name in ("operator", "session", "n", "i", "j")},
            "action": update.action,
            "pixel_i": None if update.pixel_i is None else [float(x) for x in update.pixel_i],
            "pixel_j": None if update.pixel_j is None else [float(x) for x in update.pixel_j],
        }
        with self._notes.open("a") as notes:
            notes.write(json.dumps(record) + "\n")
        self._keep(update)
        receipts = messages.Receipts(
            operator=update.operator,
            session=update.session,
            n=update.n,
            rejections=(),
            server_epoch=self._epoch,
        )
        self._put(self._keys.receipts(update.operator), receipts)

    def _fill(self, selected: Selection) -> None:
        """As many points as were asked for in the views that are held, once for a pair."""
        views = selected.view_i, selected.view_j
        if not self._load.points or None in views or selected.i is None or selected.j is None:
            return
        pair = selected.i, selected.j
        if pair in self._sets and self._sets[pair].items[0].view_i == views[0]:
            return
        places = self._rng.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (self._load.points, 2))
        self._publish(pair, tuple(_item(k + 1, "lee", *views, p, p) for k, p in enumerate(places)))

    def _keep(self, update: OperatorUpdate) -> None:
        """The newest few correspondences of a pair stay: the screen is not to drown in them."""
        pair = (update.i, update.j)
        known = self._sets.get(pair)
        items = known.items if known else ()
        places = (update.view_i, update.view_j, update.pixel_i, update.pixel_j)
        if update.action == "add" and all(place is not None for place in places):
            item = _item(update.n + self._load.points, update.operator, *places)
            items = (*items, item)[-(KEPT + self._load.points) :]
        self._publish(pair, items)

    def _publish(self, pair: tuple[str, str], items: tuple[messages.Correspondence, ...]) -> None:
        known = self._sets.get(pair)
        revision = known.revision + 1 if known else 1
        self._sets[pair] = PairCorrespondences(
            i=pair[0], j=pair[1], revision=revision, items=items, server_epoch=self._epoch
        )
        self._put(self._keys.correspondences(*pair), self._sets[pair])

    def _kept(self, robot: str, asked: dict[str, str]) -> Answer:
        view = ViewName(robot=robot, epoch=self._robot_epoch, seq=int(asked["seq"]))
        turn = self._images[self._names.index(robot) % 2]
        cloud = messages.ScatteredCloud(count=0, pixel_step_px=1 / 64, depth_step_m=0.001, data=b"")
        salient = messages.Salient(extractor="rootsift", count=0, descriptor_bytes=128, data=b"")
        shown = messages.View(name=view, stamp_ns=0, camera=CAMERA, cloud=cloud, salient=salient)
        jpeg = None if asked.get("image") == "no" else turn[view.seq % len(turn)]
        kept = messages.KeptView(
            view=shown, jpeg=jpeg, image=messages.ImageHeader(view=view, stamp_ns=0)
        )
        return Answer(pack(kept), encoding_of(messages.KeptView))

    def _put(
        self,
        key: str,
        message: messages.CameraAnnouncement | messages.Receipts | PairCorrespondences,
    ) -> None:
        if key not in self._publishers:
            self._publishers[key] = self._link.latched(key)
        self._publishers[key].put(pack(message), encoding_of(type(message)))


def _item(id: int, operator: str, *places: object) -> messages.Correspondence:
    names = ("view_i", "view_j", "pixel_i", "pixel_j")
    return messages.Correspondence.model_validate(
        {
            "id": id,
            "operator": operator,
            **dict(zip(names, places, strict=True)),
            "status": "accepted",
            "residual_m": 0.01,
            "residual_px": 0.5,
        }
    )


CAMERA = messages.Camera(
    width=WIDTH,
    height=HEIGHT,
    K=np.array([[500.0, 0, WIDTH / 2], [0, 500, HEIGHT / 2], [0, 0, 1]]),
    T_robot_camera=np.eye(4),
    noise=messages.NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.01)),
    kind="views",
)
