"""The shell of the pose server: the only file of it that touches the network.

Callbacks only store. One thread reads what was stored, runs the two flows of
`pose_server.pipeline`, hands alignments to the workers, solves, and publishes.
"""

import logging
import queue
import threading
import time
from concurrent.futures import Future
from contextlib import suppress
from functools import partial

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app import queries
from fleetpose.pose_server.app.acknowledgements import Acknowledgements
from fleetpose.pose_server.app.event_queue import (
    Announced,
    Asked,
    Denied,
    EventQueue,
    Moved,
    Selected,
    ServerEvent,
    TokenSeen,
    Updated,
)
from fleetpose.pose_server.app.metrics import Metrics
from fleetpose.pose_server.app.pending_updates import PendingUpdates, StartupGrace
from fleetpose.pose_server.app.publisher import FleetPublisher
from fleetpose.pose_server.app.status import Load, Stages, server_status
from fleetpose.pose_server.app.topics import Publishers
from fleetpose.pose_server.app.view_requests import Fetched, FetchedNewest, FetchedWide, Fetcher
from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.consistency import anchoring
from fleetpose.pose_server.correspondences.journal import Journal, StoredView
from fleetpose.pose_server.correspondences.records import JournalError, Session
from fleetpose.pose_server.correspondences.store import Outcome
from fleetpose.pose_server.persistence.graph_writer import GraphWriter, graph_of
from fleetpose.pose_server.persistence.restore import GRAPH, note_frame
from fleetpose.pose_server.scheduling import affine_retries
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.pools import Engine, Pool
from fleetpose.protocol.codec import pack
from fleetpose.protocol.drops import Drops, kind_and_sender
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys, new_epoch, ordered_pair
from fleetpose.protocol.messages import KeptView, OperatorUpdate, Selection, ViewName
from fleetpose.protocol.presence import Presence
from fleetpose.protocol.session.supervisor import Supervisor
from fleetpose.protocol.transport import Answer, Link, Sample

log = logging.getLogger("pose_server")

_TICK_S = 0.05
_PRUNE_S = 2.0
_GRAPH_S = 2.0  # of which a kill may cost the graph
_STATUS_S = 1.0
_HEARD_S = 1.0  # robots take a longer silence for a loss
_ALARMS_S = 5.0
_SOLVE_SHARE = 0.25  # of the server's own thread that solving may take
_LONGEST_PAUSE_S = 1.0  # but poses must not wait longer for the next solution
_CLICKS_S = 0.3  # that a solve waits at most for what aligning clicks will say
_ANSWER_S = 2.0


class Service:
    """A running pose server. What it is given is its own to close.

    Attributes:
        stopped: set to end it.
    """

    def __init__(
        self,
        site: Site,
        journal: Journal,
        link: Link,
        settings: ServerSettings,
        pool: Pool,
        metrics: Metrics | None,
        stopped: threading.Event,
        systemd: Supervisor,
    ) -> None:
        self.site, self.journal, self.link, self.settings = site, journal, link, settings
        self.keys = Keys(settings.site)
        self.epoch = new_epoch()
        self.stopped = stopped
        self._systemd = systemd
        self._metrics = metrics
        self._queue: queue.SimpleQueue[object] = queue.SimpleQueue()
        self._drops = Drops()
        self._events = EventQueue(self.keys, self._queue, self._drops)
        put = Publishers(link).put
        self._publisher = FleetPublisher(site, self.keys, settings, self.epoch, put)
        self._heard = Acknowledgements(site, self.keys, self.epoch, put, self._drops)
        self._clouds = link.on_bulk(self.keys.cloud("*"), self._events.wake)
        self._engine = Engine(pool, self._queue.put)
        ask = partial(link.query, background=True)  # robots' next views are worth more
        self._fetcher = Fetcher(self.keys, ask, self._queue.put, self._drops)
        self._pending = PendingUpdates(self._fetcher.ask)
        self._early = StartupGrace(time.monotonic(), self._is_known)
        self._load = Load(time.monotonic())
        self._graph_writer = GraphWriter(
            settings.state_dir / GRAPH, lambda said: self._queue.put(ServerEvent(said))
        )
        self._stages = Stages()
        self._next: dict[str, float] = {}
        self._solved_s = self._solve_took_s = 0.0
        self._clean_s = 0.0
        self._noted_frame: tuple[str | None, int] | None = None
        self._unclicked = self._clicks_aligned = False
        self._unanswered: dict[Session, OperatorUpdate] = {}
        self._untold: set[tuple[str, str]] = set()
        self._imaged: set[ViewName] = set()

    def run(self) -> None:
        """Serves until stopped.

        Raises:
            NameTakenError: another server of the site is alive, or has taken it over.
        """
        presence = Presence(
            self.link,
            everybody=self.keys.server_alive("*"),
            mine=self.keys.server_alive(self.epoch),
            who=f"a pose server of site '{self.settings.site}'",
            remedy="end that server, choose another --site, or start with --takeover",
            takeover=self.settings.takeover,
        )
        self._events.subscribe(self.link)
        self.link.queryable(self.keys.relative, partial(self._ask, queries.relative))
        self.link.queryable(self.keys.why, partial(self._ask, queries.why))
        view = partial(queries.journalled_view, self.journal)
        self.link.queryable(self.keys.server_view, view)
        workers = self.settings.workers
        self.site.say(
            f"server {self.epoch} started with {workers} worker{'s' if workers > 1 else ''}"
        )
        log.info("serving site=%s epoch=%s", self.settings.site, self.epoch)
        for pair in self.site.correspondences.pairs():
            self._publisher.correspondences(pair)
        while not self.stopped.is_set():
            presence.check()
            self._read_events()
            self._read_clouds()
            self._start_jobs()
            self._solve_if_due()
            self._publisher.moved()
            self._publish_steadily()

    def close(self) -> None:
        """Ends the workers and the session."""
        self._systemd.stopping()
        if self._metrics is not None:
            self._metrics.close()
        self._fetcher.close()
        self._engine.close()
        self._graph_writer.offer(graph_of(self.site))
        self._graph_writer.close()
        self.link.close()
        self.journal.close()

    def _read_events(self) -> None:
        """Waits for the first event up to a tick, then takes what is there, within a time: other
        work must not wait for ever behind a flood.
        """
        with suppress(queue.Empty):
            waiting = len(self._clouds) or self.site.pair_queue.to_compare
            event = self._queue.get(timeout=0.0 if waiting else _TICK_S)
            end_s = time.monotonic() + _TICK_S
            while True:
                self._handle(event)
                if time.monotonic() > end_s:
                    break
                event = self._queue.get_nowait()
        for update in self._early.ready(time.monotonic()):
            self._updated(update)
        self._answer_operators()

    def _handle(self, event: object) -> None:
        match event:
            case Done():
                self._finished(event)
            case Updated():
                self._updated(event.update)
            case Selected():
                self._selected(event.selection)
            case Fetched():
                self._fetched(event)
            case FetchedWide():
                affine_retries.receive(self.site, event.name, event.payload)
                self._ask_for_wide_sets()
            case FetchedNewest():
                self._viewed(event.kept)
            case TokenSeen():
                self._token(event)
            case Moved():
                self.site.odometers.note(event.odometry)
            case Announced():
                monitor.note_announcement(self.site, event.announcement)
            case Denied():
                pipeline.receive_denials(self.site, event.denials)
            case ServerEvent():
                self.site.say(event.text)
            case Asked():
                event.answer.set_result(event.reply())
            case _:
                pass

    def _selected(self, selection: Selection) -> None:
        before = self.site.pinned()
        for view in pipeline.receive_selection(self.site, selection, time.monotonic()):
            if self._lives(view):
                self._fetcher.ask(view)
        self._engine.prepare([self.site.encoded(v) for v in self.site.pinned() if v not in before])

    def _token(self, seen: TokenSeen) -> None:
        try:
            pipeline.receive_token(self.site, seen.robot, seen.epoch, seen.alive)
        except FleetPoseError as error:
            self._drops.note(self.keys.robot_alive(seen.robot, seen.epoch), error)
            return
        robot = self.site.robots.get(seen.robot)
        if robot is not None and robot.epoch is not None and robot.newest is None:
            self._fetcher.ask_newest(robot.name)

    def _read_clouds(self) -> None:
        """First come, first served; a few at a time, so that clicks never wait behind views."""
        end_s = time.monotonic() + _TICK_S
        good = 0
        while good < 4 and time.monotonic() < end_s:
            sample = self._clouds.take(0)
            if sample is None:
                return
            try:
                with self._stages.timed("open_view"):
                    now_s = time.monotonic()
                    view = open_view(sample.payload, sample.encoding, now_s, self.site.newest_view)
                if self.keys.chunks(sample.key)[1] != view.name.robot:
                    raise CodecError("view under another robot's key")
                monitor.note_arrival(self.site, view, time.time_ns())
                pipeline.receive_view(self.site, view)
                good += 1
                self._heard.tell(view.name.robot, sample.at_s)
            except FleetPoseError as error:
                self._refuse(sample, error)

    def _refuse(self, sample: Sample, error: FleetPoseError) -> None:
        """Counts a view that cannot be used, and keeps why at its robot."""
        self._drops.note(sample.key, error)
        _, _, name = kind_and_sender(sample.key)[1].partition("/")
        pipeline.refuse_view(self.site, name, error)

    def _viewed(self, kept: KeptView) -> None:
        """Takes the newest view of a robot that was there before this server."""
        try:
            view = open_view(pack(kept.view), None, time.monotonic())
            pipeline.receive_view(self.site, view)
        except FleetPoseError as error:
            self._drops.note(self.keys.view(kept.view.name.robot), error)

    def _start_jobs(self) -> None:
        compare_some(self.site, time.monotonic())
        while self._engine.idle_for_urgent and (job := pipeline.urgent_job(self.site)):
            self._engine.submit(job)
        while self._engine.idle > 0 and (job := pipeline.next_job(self.site, time.monotonic())):
            self._engine.submit(job)

    def _finished(self, done: Done) -> None:
        if done.worker_died:
            self.site.count("worker_died")
        if not self._engine.retire(done):
            return
        if done.result is None:
            log.warning(
                "alignment failed i=%s j=%s reason=%s", done.job.i.name, done.job.j.name, done.error
            )
        else:
            self._stages.note({"job": done.wall_ms, **done.result.timings_ms})
        telling = pipeline.take_result(self.site, done, time.monotonic())
        self._clicks_aligned |= done.job.urgent
        self._ask_for_wide_sets()
        i, j = done.job.i.name, done.job.j.name
        if telling and i.robot != j.robot:
            result = done.outcome
            self._publisher.alignment(i, j, result)
            found = (result.verdict, result.start, result.inliers, "; ".join(result.reasons))
            log.info("aligned i=%s j=%s verdict=%s start=%s inliers=%d reasons=%s", i, j, *found)

    def _ask_for_wide_sets(self) -> None:
        for view in affine_retries.wanted(self.site):
            self._fetcher.ask_wide(view)

    def _updated(self, update: OperatorUpdate) -> None:
        if self._early.holds(update, time.monotonic()):
            return
        views = {view for view in (update.view_i, update.view_j) if view is not None}
        missing = {view for view in views if view not in self.site.views and self._lives(view)}
        if missing and self._pending.parks(update, missing):
            return
        try:
            outcomes = pipeline.receive_update(self.site, update)
        except JournalError as error:  # nothing happened: the operator's client will repeat it
            log.error("update %s/%d not recorded: %s", update.operator, update.n, error)
            self.site.say(f"the journal cannot be written: {error}")
            return
        for outcome in outcomes:
            said = "accepted" if outcome.accepted else f"rejected reason={outcome.reason}"
            log.info("update operator=%s n=%d %s", update.operator, outcome.n, said)
        self._unclicked |= any(outcome.action != "add" for outcome in outcomes)
        self._unanswered[update.operator, update.session] = update
        self._untold.update((ordered_pair(update.i, update.j), *(done.pair for done in outcomes)))
        self._ask_for_images(outcomes)

    def _answer_operators(self) -> None:
        """Receipts are cumulative and sets whole: one of each does for all updates of a turn."""
        for update in self._unanswered.values():
            self._publisher.receipts(update)
        for pair in filter(self.site.knows, self._untold):
            self._publisher.correspondences(pair)
        self._unanswered.clear()
        self._untold.clear()

    def _is_known(self, view: ViewName) -> bool:
        """Whether a view is kept, or its robot is there to be asked."""
        robot = self.site.robots.get(view.robot)
        return view in self.site.views or (robot is not None and robot.epoch is not None)

    def _lives(self, view: ViewName) -> bool:
        """Whether the robot that took a view is there and may still have it."""
        robot = self.site.robots.get(view.robot)
        return robot is not None and robot.epoch == view.epoch

    def _ask_for_images(self, outcomes: list[Outcome]) -> None:
        """The images of clicked views are journalled, so that the clicks can be shown for ever."""
        for view in {view for outcome in outcomes for view in outcome.views}:
            if view not in self._imaged and self._lives(view):
                self._imaged.add(view)
                self._fetcher.ask(view)

    def _fetched(self, fetched: Fetched) -> None:
        """Keeps a view that its robot was asked for, and goes on with the clicks in it."""
        kept, refused = fetched.kept, fetched.reason
        if kept is not None and fetched.name not in self.site.views:
            try:
                view = open_view(pack(kept.view), None, time.monotonic())
                pipeline.receive_fetched(self.site, view)
                if fetched.name in self.site.pinned():
                    self._engine.prepare([self.site.encoded(fetched.name)])
            except CodecError as error:
                refused = str(error)
        for update in self._pending.answered(fetched.name, refused):
            self._updated(update)
        if kept is not None and kept.jpeg and fetched.name in self.site.correspondences.views():
            encoded = self.site.views[fetched.name].payload
            try:
                self.journal.keep_view(StoredView(fetched.name, encoded, kept.jpeg, kept.image))
            except JournalError as error:
                log.error("image of %s not recorded: %s", fetched.name, error)

    def _solve_if_due(self) -> None:
        now = time.monotonic()
        if not self.site.dirty:
            self._clean_s = now
            return
        pause = min(self._solve_took_s * (1 / _SOLVE_SHARE - 1), _LONGEST_PAUSE_S)
        clicks_on_their_way = self._engine.running_urgent and now < self._clean_s + _CLICKS_S
        pausing = now < self._solved_s + pause and not self._clicks_aligned
        if pausing or clicks_on_their_way:
            return
        self._clicks_aligned = False
        with self._stages.timed("solve"):
            pipeline.solve(self.site, now)
        pipeline.note_components(self.site)
        self._note_frame()
        self._solve_took_s = time.monotonic() - now
        self._solved_s = time.monotonic()
        for pair in pipeline.judge_correspondences(self.site):
            self._publisher.correspondences(pair)

    def _note_frame(self) -> None:
        """After a restart the fleet frame must not silently be another one."""
        now = (self.site.anchor, self.site.gauge_revision)
        if now == self._noted_frame:
            return
        self._noted_frame = now
        try:
            note_frame(self.journal, self.site)
        except JournalError as error:
            log.error("the gauge was not recorded: %s", error)

    def _publish_steadily(self) -> None:
        if self._due("state", 1.0 / self.settings.state_hz):
            with self._stages.timed("state"):
                pause_s = self._publisher.state()
            self._next["state"] = max(self._next["state"], time.monotonic() + pause_s)
        if self._due("status", _STATUS_S):
            anchoring.note_anchor(self.site, time.monotonic())
            drops = {
                **self._drops.snapshot(),
                "newer_view": self._clouds.replaced,
                "no_room": self._clouds.overflowed,
            }
            self._publish_status(drops)
        if self._due("heard", _HEARD_S):
            self._heard.tell_all()
        if self._due("alarms", _ALARMS_S):
            monitor.judge_calibrations(self.site)
        if self._due("graph", _GRAPH_S):
            self._graph_writer.offer(graph_of(self.site))
        if self._due("prune", _PRUNE_S):
            self._prune()

    def _publish_status(self, drops: dict[str, int]) -> None:
        now = self._publisher.stamp()
        status = server_status(self.site, self._engine, self._load, self._stages, now, drops)
        self._publisher.put(self.keys.status, status)
        robots = self.site.robots.values()
        located = sum(r.alive and r.published is not None and r.published.located for r in robots)
        self._systemd.alive(f"{located} of {len(robots)} robots located")
        if self._metrics is not None:
            self._metrics.show(status, len(robots), located)

    def _prune(self) -> None:
        """Lets go of views that are old and that nothing holds."""
        dropped = self.site.views.prune(time.monotonic(), self.site.held())
        self.site.odometers.forget(dropped)
        for robot in self.site.robots.values():
            robot.track.forget({view for view in dropped if view.robot == robot.name})
        if not self._unclicked:
            return
        try:
            self.journal.keep_only_views(self.site.correspondences.views())
            self._unclicked = False
        except JournalError as error:
            log.error("unclicked views stay in the journal: %s", error)

    def _due(self, what: str, period_s: float) -> bool:
        now = time.monotonic()
        if now < self._next.get(what, 0.0):
            return False
        self._next[what] = now + period_s
        return True

    def _ask(self, reply: queries.Reply, parameters: dict[str, str]) -> Answer:
        """Has the server's own thread answer; runs in a thread of its own."""
        asked = Asked(lambda: reply(self.site, self.settings, parameters), Future())
        self._queue.put(asked)
        try:
            return asked.answer.result(_ANSWER_S)
        except TimeoutError:
            return Answer(error="the server is busy: ask again")
