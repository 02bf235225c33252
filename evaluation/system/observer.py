"""Listens to a running fleet and notes what arrives when, by this process's monotonic clock."""

import hashlib
import itertools
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from fleetpose.protocol import codec
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Alignment,
    DepthCloud,
    FleetState,
    RobotPose,
    ScatteredCloud,
    ServerStatus,
    View,
    ViewName,
)
from fleetpose.protocol.transport import Link, Sample, Slots

KEPT_VIEWS = 60  # of each robot; poses and questions are about these


@dataclass(frozen=True)
class SeenView:
    """A view as it arrived; `digest` identifies what its cloud holds."""

    view: View
    digest: str
    received_s: float
    size_bytes: int


@dataclass(frozen=True)
class _Waiting:
    """A view without a pose as new as it; `moved`: it shows something else than the one before."""

    name: ViewName
    received_s: float
    moved: bool


@dataclass(frozen=True)
class SeenPose:
    """A pose as it arrived."""

    pose: RobotPose
    received_s: float


@dataclass(frozen=True)
class SeenAlignment:
    """That a pair was aligned, and by which start."""

    pair: tuple[str, str]
    start: str
    received_s: float


def digest_of(cloud: DepthCloud | ScatteredCloud) -> str:
    """What identifies a cloud: a hash of its encoded bytes."""
    return hashlib.sha256(cloud.data).hexdigest()


class Believed(Protocol):
    """Poses that somebody takes for true, and the views that they are of."""

    def poses(self) -> dict[str, SeenPose]: ...

    def view(self, name: ViewName) -> SeenView | None: ...


class _Arrivals(Slots):
    """All samples in order with the time of their arrival, nothing replaced."""

    def __init__(self) -> None:
        super().__init__()
        self._queue: queue.SimpleQueue[tuple[float, Sample] | None] = queue.SimpleQueue()

    def store(self, sample: Sample) -> None:
        self._queue.put((time.monotonic(), sample))

    def close(self) -> None:
        self._queue.put(None)

    def __iter__(self) -> Iterator[tuple[float, Sample]]:
        while (arrival := self._queue.get()) is not None:
            yield arrival


class Observer:
    """Subscribes to all that robots and server publish. All attributes may be read from any thread.

    Args:
        link: the evaluation's own session; it must outlive this, as must the next.
        keys: of the site.
        as_server: a session that hears views and tokens where rules keep them from the other one.

    Attributes:
        located_counts: (time, number of robots located) at every change of that number.
        view_to_pose_s: per view, from its arrival here to that of the first pose as new as it.
            Views that such a pose overtook on the way tell nothing of it and are left out.
        moving_view_to_pose_s: of these, views that show something else than their robot's last one.
            Who stands still sends the same again, and costs the server next to nothing.
        views_overtaken: how many were left out.
    """

    def __init__(self, link: Link, keys: Keys, as_server: Link | None = None) -> None:
        self.link, self.keys = link, keys
        self._arrivals = _Arrivals()
        self._lock = threading.Lock()
        self._views: dict[str, SeenView] = {}
        self._views_by_name: dict[str, SeenView] = {}
        self._names: dict[str, deque[str]] = {}
        self._poses: dict[str, SeenPose] = {}
        self._waiting: dict[str, list[_Waiting]] = {}
        self._alive: set[str] = set()
        self.state: FleetState | None = None
        self.states_heard = 0
        self.statuses: list[tuple[float, ServerStatus]] = []
        self.alignments: list[SeenAlignment] = []
        self.pose_arrivals: list[tuple[float, str]] = []
        self.located_counts: list[tuple[float, int]] = [(time.monotonic(), 0)]
        self.view_to_pose_s: list[float] = []
        self.moving_view_to_pose_s: list[float] = []
        self.views_overtaken = 0
        self.view_sizes: list[int] = []
        self.undecodable = 0
        self._subscribe(link, as_server or link)
        self._thread = threading.Thread(target=self._run, name="observer", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread; the link is closed by whoever opened it."""
        self._arrivals.close()
        self._thread.join()

    def newest_view(self, robot: str) -> SeenView | None:
        with self._lock:
            return self._views.get(robot)

    def newest_views(self) -> list[SeenView]:
        """The newest view of each robot."""
        with self._lock:
            return list(self._views.values())

    def view(self, name: ViewName) -> SeenView | None:
        """A view by its name; the newest of each robot are kept."""
        with self._lock:
            return self._views_by_name.get(str(name))

    def poses(self) -> dict[str, SeenPose]:
        """The newest pose of each robot."""
        with self._lock:
            return dict(self._poses)

    def views_unanswered(self) -> int:
        """Views that no pose has answered so far."""
        with self._lock:
            return sum(map(len, self._waiting.values()))

    def first_alignment_s(self, pair: tuple[str, str], since_s: float) -> float | None:
        """When the pair was first aligned after a time."""
        with self._lock:
            times = (a.received_s for a in reversed(self.alignments) if a.pair == pair)
            return _first_after(times, since_s)

    def first_pose_s(self, robots: tuple[str, ...], since_s: float) -> float | None:
        """When a pose of one of the robots first arrived after a time."""
        with self._lock:
            times = (at_s for at_s, robot in reversed(self.pose_arrivals) if robot in robots)
            return _first_after(times, since_s)

    def longest_pose_gap_s(self, robot: str, since_s: float, until_s: float) -> float:
        """The longest time without a new pose of a robot within a stretch, ends included."""
        with self._lock:
            backward = itertools.takewhile(lambda one: one[0] > since_s, self.pose_arrivals[::-1])
            times = [at_s for at_s, of in backward if of == robot and at_s < until_s]
        return max(b - a for a, b in itertools.pairwise((since_s, *reversed(times), until_s)))

    def lives(self, robot: str) -> set[str]:
        """Epochs of a robot whose token is there."""
        with self._lock:
            return {key.rsplit("/", 1)[-1] for key in self._alive if f"/robot/{robot}/" in key}

    def alive_robots(self) -> int:
        """Robots whose token is there."""
        with self._lock:
            return sum(1 for key in self._alive if "/robot/" in key)

    def server_alive(self) -> bool:
        return bool(self.server_epochs())

    def server_epochs(self) -> set[str]:
        """Of the servers whose token is there."""
        with self._lock:
            return {key.rsplit("/", 1)[-1] for key in self._alive if "/server/" in key}

    def _subscribe(self, link: Link, as_server: Link) -> None:
        keys = self.keys
        self._clouds = as_server.subscribe_bulk(keys.cloud("*"), self._arrivals.store)
        for key in (keys.poses, keys.state, keys.status, keys.alignment("*", "*")):
            link.on_latched(key, self._arrivals.store)
        for key in (keys.robot_alive("*", "*"), keys.server_alive("*")):
            as_server.on_alive(key, self._note_alive)

    def _note_alive(self, key: str, alive: bool) -> None:
        with self._lock:
            (self._alive.add if alive else self._alive.discard)(key)

    def _run(self) -> None:
        handlers: dict[str, tuple[type[Any], Callable[[Any, float, int], None]]] = {
            codec.encoding_of(kind): (kind, handler)
            for kind, handler in (
                (View, self._on_view),
                (RobotPose, self._on_pose),
                (FleetState, self._on_state),
                (ServerStatus, self._on_status),
                (Alignment, self._on_alignment),
            )
        }
        for received_s, sample in self._arrivals:
            try:
                kind, handler = handlers[sample.encoding]
                message = codec.unpack(kind, sample.payload)
            except (FleetPoseError, KeyError):
                self.undecodable += 1
                continue
            with self._lock:
                handler(message, received_s, len(sample.payload))

    def _on_view(self, view: View, received_s: float, size: int) -> None:
        if str(view.name) in self._views_by_name:
            return  # a repeat
        seen = SeenView(view, digest_of(view.cloud), received_s, size)
        before = self._views.get(view.name.robot)
        moved = before is not None and before.digest != seen.digest
        self._views[view.name.robot] = seen
        self._views_by_name[str(view.name)] = seen
        names = self._names.setdefault(view.name.robot, deque())
        names.append(str(view.name))
        if len(names) > KEPT_VIEWS:
            del self._views_by_name[names.popleft()]
        self.view_sizes.append(size)
        last = self._poses.get(view.name.robot)
        if last is not None and _covers(last.pose.view, view.name):
            self.views_overtaken += 1  # poses have priority: its own overtook it
        else:
            waiting = _Waiting(view.name, received_s, moved)
            self._waiting.setdefault(view.name.robot, []).append(waiting)

    def _on_pose(self, pose: RobotPose, received_s: float, _: int) -> None:
        last = self._poses.get(pose.robot)
        if last and (last.pose.server_epoch, last.pose.n) == (pose.server_epoch, pose.n):
            return  # a repeat
        self._poses[pose.robot] = SeenPose(pose, received_s)
        self.pose_arrivals.append((received_s, pose.robot))
        waiting = self._waiting.get(pose.robot, [])
        answered = [view for view in waiting if _covers(pose.view, view.name)]
        self.view_to_pose_s += [received_s - view.received_s for view in answered]
        self.moving_view_to_pose_s += [
            received_s - view.received_s for view in answered if view.moved
        ]
        self._waiting[pose.robot] = [view for view in waiting if view not in answered]
        located = sum(1 for seen in self._poses.values() if seen.pose.located)
        if located != self.located_counts[-1][1]:
            self.located_counts.append((received_s, located))

    def _on_state(self, state: FleetState, *_: object) -> None:
        self.state = state
        self.states_heard += 1

    def _on_status(self, status: ServerStatus, received_s: float, _: int) -> None:
        self.statuses.append((received_s, status))

    def _on_alignment(self, alignment: Alignment, received_s: float, _: int) -> None:
        pair = (alignment.view_i.robot, alignment.view_j.robot)
        self.alignments.append(SeenAlignment(pair, alignment.start, received_s))


def _covers(posed: ViewName, view: ViewName) -> bool:
    return posed.epoch == view.epoch and posed.seq >= view.seq


def _first_after(times_backward: Iterable[float], since_s: float) -> float | None:
    later = list(itertools.takewhile(lambda at_s: at_s > since_s, times_backward))
    return later[-1] if later else None


def first_time_located(
    counts: list[tuple[float, int]], robots: int, since_s: float
) -> float | None:
    """Seconds from `since_s` until at least so many robots were located at once; none if never."""
    for at_s, located in counts:
        if located >= robots:
            return max(at_s - since_s, 0.0)
    return None
