"""One operator's desk behind all the pages that he has open.

A thread of its own does what pages ask, follows the session, and makes the frames, once for all
pages; pages take what has changed since they last sent. So no page holds another up, and nothing
is computed in the thread that serves.
"""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any, Protocol, get_args

from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.model.changes import Topic
from fleetpose.hmi_client.web import told
from fleetpose.hmi_client.web.clouds import Cloud, Clouds
from fleetpose.hmi_client.web.heard import OF_RECORDINGS, Heard
from fleetpose.hmi_client.web.outlook import Outlook, Pictures
from fleetpose.hmi_client.web.page_settings import PageSettings
from fleetpose.hmi_client.web.seats import Seat
from fleetpose.protocol.errors import FleetPoseError

log = logging.getLogger(__name__)

GATHER_S = 0.002  # what changes is told by several messages
BREATH_S, IDLE_BREATH_S = 0.008, 0.05  # between two looks at what has changed
HAND_S = 2.0  # after what a page asked for
LOOK_S = 0.25  # at the longest: silence has no event
FLEET_S = 0.5  # between two matrices, and two maps
HEALTH_S = 1.0
ANSWER_S = 0.05  # a click that is confirmed so soon is told once: its page has drawn it already
EVENTS_KEPT = 50
_URGENT = ("server", "kept", "unconfirmed", "confirmed", "robots", "located")
_TOPICS: tuple[Topic, ...] = tuple(
    topic for part in get_args(Topic) for topic in (get_args(part) or (part,))
)
_LIST: tuple[Topic, ...] = (
    *("correspondences", "updates", "selection", "pictures"),
    *("depths", "others", "fleet", "alignment", "settings"),
)


class Guest(Protocol):
    """A page, as its desk sees it. All may be called by any thread."""

    images: bool
    matrix: bool
    clouds: bool

    def wake(self) -> None:
        """There is something new to be sent."""
        ...

    def tell(self, frame: told.Frame) -> None:
        """Sends a frame to this page alone."""
        ...


class DeskLink:
    """The desk of one operator and its pages.

    Args:
        seat: the desk and what feeds it.
        site: its name.
        address: where its server is, for sentences.
        keymap: the keys of the commands.
        settings: of the operator's pages.
        on_failure: called with a bug that ended the work.
    """

    def __init__(
        self,
        seat: Seat,
        site: str,
        address: str,
        keymap: KeyMap,
        settings: PageSettings,
        on_failure: Callable[[Exception], None],
    ) -> None:
        self.seat, self._site, self._address = seat, site, address
        self._keymap, self._settings, self._on_failure = keymap, settings, on_failure
        self.outlook, self.pictures = Outlook(), Pictures()
        self.clouds: Clouds | None = None
        self._guests: set[Guest] = set()
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._desk: Desk | None = None
        self._seen: dict[str, int] = {}
        self._answer_due_s, self._asked_s = 0.0, -HAND_S
        self._fleet_key: Any = None
        self._fleet_s = self._health_s = -1e9
        self._events: deque[tuple[int, str]] = deque(maxlen=EVENTS_KEPT)
        self._event_count = self._notice_count = 0
        self._threads = [
            threading.Thread(name=f"web {what}", target=self._guarded, args=(work,), daemon=True)
            for what, work in (("desk", self._run), ("watch", self._watch))
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Ends the threads, the desk and what feeds it."""
        self._stop.set()
        self._jobs.put(None)
        for thread in self._threads:
            thread.join(5.0)
        if self.clouds is not None:
            self.clouds.close()
        self.seat.desk.close()
        self.seat.close()

    # ---- pages; from any thread ------------------------------------------------------------------

    def welcome(self) -> told.Frame:
        """The first frame of a page."""
        operator = self.seat.desk.session.operator
        settings, replay = self._settings.values, self.seat.replay
        return told.welcome(operator, self._site, self._keymap, settings, replay)

    def join(self, guest: Guest) -> None:
        """A page is there."""
        self._jobs.put(lambda: self._guests.add(guest))

    def leave(self, guest: Guest) -> None:
        """A page has gone."""
        self._jobs.put(lambda: self._guests.discard(guest))

    def do(self, guest: Guest, heard: Heard) -> None:
        """A page asks for something; a refusal is told to that page."""
        self._asked_s = time.monotonic()
        self._jobs.put(lambda: self._do(guest, heard))

    @property
    def events(self) -> list[tuple[int, str]]:
        """What happened, as frames, each with a number that grows."""
        return list(self._events)

    @property
    def cloud_of(self) -> Mapping[str, Cloud]:
        """The points known of each robot."""
        return {} if self.clouds is None else dict(self.clouds.known)

    # ---- the desk's thread -----------------------------------------------------------------------

    def _guarded(self, target: Callable[[], None]) -> None:
        try:
            target()
        except Exception as error:  # a bug: whoever serves must end and tell it
            if not self._stop.is_set():
                log.exception("%s failed", threading.current_thread().name)
                self._on_failure(error)

    def _watch(self) -> None:
        """Wakes the desk's thread when the session has changed."""
        session, seen = self.seat.desk.session, dict[str, int]()
        while not self._stop.is_set():
            if session is not self.seat.desk.session:  # a recording is played anew
                session, seen = self.seat.desk.session, {}
            session.wait_change(seen, _TOPICS, LOOK_S)
            self._stop.wait(GATHER_S)
            seen = session.revisions()  # now: what changes from here on wakes again
            self._jobs.put(None)
            idle = time.monotonic() - self._asked_s > HAND_S
            self._stop.wait(IDLE_BREATH_S if idle else BREATH_S)

    def _run(self) -> None:
        while not self._stop.is_set():
            left_s = self._answer_due_s - time.monotonic()
            with contextlib.suppress(queue.Empty):
                job = self._jobs.get(timeout=left_s if left_s > 0 else None)
                while job is not None or not self._jobs.empty():
                    if job is not None:
                        job()
                    job = None if self._jobs.empty() else self._jobs.get()
            if self.seat.failure is not None:
                raise self.seat.failure
            if not self._awaits_answer() and self._look():
                for guest in self._guests:
                    guest.wake()

    def _do(self, guest: Guest, heard: Heard) -> None:
        desk = self._followed()
        if heard.do == "pick":
            self.outlook.renew("list")  # the page has drawn it already: it is told what came of it
            self._answer_due_s = time.monotonic() + ANSWER_S
        try:
            if heard.do == "settings":
                self._settings.set(heard.args.get("set", {}))
            elif heard.do in OF_RECORDINGS:
                self.seat.play(heard.do, dict(heard.args))
            elif heard.do == "why":
                robot = heard.args.get("robot") or desk.in_question() or desk.session.robots()[:1]
                guest.tell(told.why(desk, str(robot if isinstance(robot, str) else robot[0])))
            else:
                self._do_at_desk(desk, guest, heard)
        except (FleetPoseError, IndexError) as error:
            text = str(error) if isinstance(error, FleetPoseError) else "no robot is known yet"
            guest.tell(told.notice(text))

    def _do_at_desk(self, desk: Desk, guest: Guest, heard: Heard) -> None:
        args = dict(heard.args)
        if "view" in args:
            args["seen"] = self.pictures.seen(args.pop("view"))
        asked = {args.get("side", desk.side): tuple(args.get("pixel", ()))}
        if heard.do == "go" and "pixel" in args:
            desk.do("cursor", side=args.get("side"), pixel=args.pop("pixel"))
        before = desk.cursor(0), desk.cursor(1)
        if "beside" in args:
            args["beside"] = self.pictures.known(args["beside"])
        desk.do(heard.do, **args)
        for side in (0, 1):
            now = desk.cursor(side)
            if now != before[side] and now != asked.get(side):
                guest.tell(told.cursor(side, now))

    # ---- looking ---------------------------------------------------------------------------------

    def _awaits_answer(self) -> bool:
        """Whether a point was put just now, and may be confirmed before anything is to be told."""
        session = self._followed().session
        on_its_way = session.half is None and session.unconfirmed > 0
        return on_its_way and time.monotonic() < self._answer_due_s

    def _followed(self) -> Desk:
        """The seat's desk; what is known of an earlier one is forgotten."""
        desk = self.seat.desk
        if desk is not self._desk:
            self._desk, self._seen, self._fleet_key = desk, {}, None
            self._event_count = self._notice_count = 0
            desk.helper.ready = lambda: self._jobs.put(None)
        return desk

    def _look(self) -> bool:
        """Brings all frames up to date; whether one has changed."""
        desk, put = self._followed(), self.outlook.put
        desk.follow()
        revisions = desk.session.revisions()

        def fresh(topics: tuple[Topic, ...]) -> bool:
            return not self._seen or any(
                revisions.get(t, 0) != self._seen.get(t, 0) for t in topics
            )

        changed = self.pictures.follow(desk)
        if fresh(("fleet",)):
            changed |= put("names", told.names(desk)) | put("questions", told.questions(desk))
        changed |= put("step", told.step(desk))
        if fresh(_LIST) or self.outlook.value("list") is None:
            changed |= put("list", told.points(desk)) | put("pair", told.pair(desk))
        changed |= put("assist", told.assist(desk)) | put("clock", self.seat.clock())
        self._seen = revisions
        changed |= self._look_at_fleet(desk) | self._look_at_clouds(desk)
        return self._say(desk) | self._look_at_health(desk) | changed

    def _look_at_fleet(self, desk: Desk) -> bool:
        """Matrix and map, which cost the most, seldom and only while they are looked at."""
        session, now = desk.session, time.monotonic()
        key = (
            *(self._seen.get("fleet"), self._seen.get("poses"), session.pair),
            *(desk.quantity, session.threshold_m),
        )
        wanted = any(guest.matrix for guest in self._guests)
        if key == self._fleet_key or not wanted or now - self._fleet_s < FLEET_S:
            return False
        self._fleet_key, self._fleet_s = key, now
        return self.outlook.put_fleet(desk)

    def _look_at_clouds(self, desk: Desk) -> bool:
        wanted = not self.seat.replay and any(guest.clouds for guest in self._guests)
        if wanted and self.clouds is None:
            wake = lambda: self._jobs.put(None)  # noqa: E731
            self.clouds = Clouds(desk.session, self.seat.fetch_view, wake)
        if self.clouds is not None:
            self.clouds.pause(not wanted)
            return self.clouds.is_new()
        return False

    def _look_at_health(self, desk: Desk) -> bool:
        now = time.monotonic()
        health = told.health(desk, self._address)
        urgent = self.outlook.value("health") or {}
        same = all(urgent.get(k) == health[k] for k in _URGENT)
        if same and now - self._health_s < HEALTH_S:
            return False
        self._health_s = now
        self.outlook.put("health", health, always=True)
        return True

    def _say(self, desk: Desk) -> bool:
        """Events for all pages, now and later; notices for those that are here."""
        events, self._event_count = desk.session.events_since(self._event_count)
        at_ms = time.time_ns() // 1_000_000
        first = self._events[-1][0] + 1 if self._events else 1
        for k, text in enumerate(events):
            self._events.append((first + k, told.text_of(told.event(text, at_ms))))
        notices, self._notice_count = desk.notices_since(self._notice_count)
        for guest in self._guests:
            for notice in notices:
                guest.tell(told.notice(notice.text, notice.tone))
        return bool(events)
