"""The server of a recorded site, without network and clock: what it heard comes in order of
arrival, what it does takes time by the recording's clock alone.

A job occupies a worker for as long as jobs took when the site was recorded, whatever it takes now;
so the same jobs are chosen in the same order on every machine.
"""

import heapq
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

import zenoh

from fleetpose.evaluation.bench.replay.inputs import Recorded
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app.event_queue import (
    Announced,
    Denied,
    EventQueue,
    Moved,
    Selected,
    TokenSeen,
)
from fleetpose.pose_server.app.event_queue import Updated as UpdateHeard
from fleetpose.pose_server.app.publisher import FleetPublisher
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.consistency import anchoring
from fleetpose.pose_server.correspondences.records import BookState, Change
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.messages.builders import Stamp
from fleetpose.pose_server.scheduling import affine_retries
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done, Job
from fleetpose.pose_server.workers.run import forget_views, run_job
from fleetpose.protocol.codec import encoding_of
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import View
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.recording.file import HERE, Record
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link

if TYPE_CHECKING:
    from fleetpose.pose_server.registration.verdict.evaluate import PairResult

EPOCH = "0" * 12
TICK_S = 0.25  # solving and telling: as often as a server tells the fleet's state
_SLOW_TICKS = 4  # what a server does once a second or less
Aligner = Callable[[Job], "PairResult"]


class _Remembered:
    """A journal that keeps nothing, and knows how far operators were before the recording."""

    def __init__(self, recorded: Recorded) -> None:
        self._recorded = recorded

    def load(self) -> BookState:
        return BookState(sessions=self._recorded.began, next_id=self._recorded.next_id)

    def record(self, change: Change) -> None:
        pass


class PlayedLink(Link):
    """A link that hears a recording."""

    def __init__(self) -> None:
        super().__init__(session=None)  # pyright: ignore[reportArgumentType] (nothing is sent)
        self._latched: list[tuple[zenoh.KeyExpr, Callable[[Sample], None]]] = []
        self._alive: list[tuple[zenoh.KeyExpr, Callable[[str, bool], None]]] = []

    def on_latched(self, key_expr: str, callback: Callable[[Sample], None]) -> None:
        self._latched.append((zenoh.KeyExpr(key_expr), callback))

    def on_alive(self, key_expr: str, callback: Callable[[str, bool], None]) -> None:
        self._alive.append((zenoh.KeyExpr(key_expr), callback))

    def play(self, record: Record) -> None:
        """Calls back who subscribed to a record's key."""
        key, sample = zenoh.KeyExpr(record.sample.key), record.sample
        if record.way == "token":
            for expression, seen in self._alive:
                if expression.includes(key):
                    seen(sample.key, sample.payload == HERE)
            return
        for expression, heard in self._latched:
            if expression.includes(key):
                heard(sample)


@dataclass
class _Clock:
    """The recording's: seconds from its beginning, and UTC."""

    now_s: float = 0.0
    begin_ns: int = 0

    @property
    def now_ns(self) -> int:
        return self.begin_ns + round(1e9 * self.now_s)


class _Publisher(FleetPublisher):
    """Tells by the recording's clock."""

    clock: _Clock

    def stamp(self) -> Stamp:
        return Stamp(EPOCH, self.clock.now_s, self.clock.now_ns)


class ReplayServer:
    """A server that hears a recording.

    Args:
        keys: of the site.
        recorded: how the server that was recorded worked.
        told: takes all that this one says: its second, the key, the message.
        align: does a job, as a worker would.

    Attributes:
        jobs: done so far, by kind.
        unanswered: views whose wide keypoints were asked for; no recording holds them.
        drops: what could not be used, by reason.
    """

    def __init__(
        self,
        keys: Keys,
        recorded: Recorded,
        told: Callable[[float, str, Message], None],
        align: Aligner = run_job,
    ) -> None:
        forget_views()
        settings = ServerSettings.model_validate({"site": keys.site})
        self.site = Site(
            correspondences=CorrespondenceStore(_Remembered(recorded)), anchor=recorded.anchor
        )
        self.jobs: dict[str, int] = {}
        self.unanswered = 0
        self.drops = Drops()
        self.clock = _Clock()
        self._keys, self._align = keys, align
        self._workers, self._job_s = recorded.workers, 1e-3 * recorded.job_ms
        self._publisher = _Publisher(
            self.site, keys, settings, EPOCH, lambda key, said: told(self.clock.now_s, key, said)
        )
        self._publisher.clock = self.clock
        self._heard: SimpleQueue[object] = SimpleQueue()
        self._link = PlayedLink()
        EventQueue(keys, self._heard, self.drops).subscribe(self._link)
        self._in_work: list[tuple[float, int, Done]] = []
        self._ticks = 0

    def hear(self, record: Record) -> None:
        """Comes to a record's moment, and takes it in."""
        self.clock.begin_ns = self.clock.begin_ns or record.at_ns - round(1e9 * record.at_s)
        self.come_to(record.at_s)
        if record.way != "token" and record.sample.encoding == encoding_of(View):
            self._take_view(record)
        elif record.way in ("in", "token"):
            self._link.play(record)
            self._take_events()
        self._start_jobs()

    def come_to(self, at_s: float) -> None:
        """Does what is due before a moment, in order: jobs end, ticks pass."""
        while True:
            tick_s = TICK_S * (self._ticks + 1)
            end_s = self._in_work[0][0] if self._in_work else float("inf")
            if min(tick_s, end_s) > at_s:
                break
            self.clock.now_s = min(tick_s, end_s)
            if end_s <= tick_s:
                self._finish(heapq.heappop(self._in_work)[2])
            else:
                self._tick()
            self._start_jobs()
        self.clock.now_s = at_s

    def end(self) -> None:
        """Solves and tells a last time."""
        self._tick(last=True)

    def _take_view(self, record: Record) -> None:
        sample = record.sample
        try:
            view = open_view(
                sample.payload, sample.encoding, self.clock.now_s, self.site.newest_view
            )
            if self._keys.chunks(sample.key)[1] != view.name.robot:
                raise CodecError("view under another robot's key")
            monitor.note_arrival(self.site, view, self.clock.now_ns)
            pipeline.receive_view(self.site, view)
        except FleetPoseError as error:
            self.drops.note(sample.key, error)

    def _take_events(self) -> None:
        while True:
            try:
                self._take(self._heard.get_nowait())
            except Empty:
                return

    def _take(self, event: Any) -> None:
        match event:
            case UpdateHeard():
                pipeline.receive_update(self.site, event.update)
            case Selected():
                pipeline.receive_selection(self.site, event.selection, self.clock.now_s)
            case Moved():
                self.site.odometers.note(event.odometry)
            case Announced():
                monitor.note_announcement(self.site, event.announcement)
            case Denied():
                pipeline.receive_denials(self.site, event.denials)
            case TokenSeen():
                try:
                    pipeline.receive_token(self.site, event.robot, event.epoch, event.alive)
                except FleetPoseError as error:
                    self.drops.note(self._keys.robot_alive(event.robot, event.epoch), error)
            case _:
                pass

    def _start_jobs(self) -> None:
        """As many at once as the recorded server had workers, and one that an operator waits
        for.
        """
        now_s = self.clock.now_s
        while compare_some(self.site, now_s):
            pass
        urgent = sum(done.job.urgent for _, _, done in self._in_work)
        if not urgent and (job := pipeline.urgent_job(self.site)):
            self._start(job)
        while sum(not done.job.urgent for _, _, done in self._in_work) < self._workers:
            job = pipeline.next_job(self.site, now_s)
            if job is None:
                return
            self._start(job)

    def _start(self, job: Job) -> None:
        try:
            done = Done(job, self._align(job))
        except FleetPoseError as error:  # filed as a server files it
            done = Done(job, None, str(error))
        number = sum(self.jobs.values())
        self.jobs[job.kind] = self.jobs.get(job.kind, 0) + 1
        heapq.heappush(self._in_work, (self.clock.now_s + self._job_s, number, done))

    def _finish(self, done: Done) -> None:
        telling = pipeline.take_result(self.site, done, self.clock.now_s)
        for view in affine_retries.wanted(self.site):
            self.unanswered += 1
            affine_retries.receive(self.site, view, None)
        i, j = done.job.views
        if telling and i.robot != j.robot:
            self._publisher.alignment(i, j, done.outcome)
        self._publisher.moved()

    def _tick(self, last: bool = False) -> None:
        site, now_s = self.site, self.clock.now_s
        self._ticks += 1
        if site.dirty:
            pipeline.solve(site, now_s)
            pipeline.note_components(site)
            pipeline.judge_correspondences(site)
        self._publisher.moved()
        if self._ticks % _SLOW_TICKS and not last:
            return
        self._publisher.state()
        anchoring.note_anchor(site, now_s)
        monitor.judge_calibrations(site)
        dropped = site.views.prune(now_s, site.held())
        site.odometers.forget(dropped)
        for robot in site.robots.values():
            robot.track.forget({view for view in dropped if view.robot == robot.name})
