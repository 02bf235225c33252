"""Plays a recording into a session: what came comes again, and what the operator did is done
again.

Nothing goes out. The session's clock is the recording's, so that ages and silences are as they
were.
"""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import ClassVar, TypeVar

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.onlooker import Onlooker
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.intake import Intake
from fleetpose.hmi_client.network.message_decoder import checked_picture
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import ImageHeader, KeptView, OperatorUpdate, Selection
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.recording.file import Record, Recording
from fleetpose.protocol.transport import Sample

M = TypeVar("M", bound=Message)


class PlayClock:
    """Seconds since the recording's beginning, which go `speed` times as fast or stand still."""

    def __init__(self, speed: float = 1.0) -> None:
        self.speed = speed
        self.paused = True
        self._at_s, self._since = 0.0, time.monotonic()

    def __call__(self) -> float:
        gone = 0.0 if self.paused else (time.monotonic() - self._since) * self.speed
        return self._at_s + gone

    def set(self, at_s: float, paused: bool) -> None:
        """Goes on from a time, or stands still there."""
        self._at_s, self._since, self.paused = at_s, time.monotonic(), paused


class PlayedSession(Onlooker):
    """A recorded operator's session. Anybody may look around in it; nobody changes it but the
    record.
    """

    refusal: ClassVar[str] = "this is a recording: nothing can be changed in it"

    def __init__(
        self, recording: Recording, clock: Callable[[], float], threshold_m: float | None = None
    ) -> None:
        if not recording.operator:
            raise OperatorError(
                f"{recording.path} is of a whole site, not of an operator's session: see "
                "'pose-eval replay' and 'pose-server show'"
            )
        first = next(_sent(recording, OperatorUpdate), None)
        told = next(_sent(recording, Selection), None)
        epoch = told.session if told is not None else None
        super().__init__(recording.operator, epoch, clock, threshold_m)
        if first is not None:
            self._book.outbox.begin_after(first.n - 1)

    def follow(self, selection: Selection) -> None:
        """Looks at what the operator looked at, held still or not."""
        self._book.outbox.session = selection.session
        if selection.i is None or selection.j is None:
            return
        self.select(selection.i, selection.j)
        if selection.view_i is not None and selection.view_j is not None:
            self.hold(selection.view_i, selection.view_j)
        elif selection.view_i is not None or selection.view_j is not None:
            self.hold_still()
        else:
            self.release()

    def repeat(self, update: OperatorUpdate) -> None:
        """Does again what the operator did; what was offered again is done once."""
        self._book.outbox.session = update.session
        if update.n > self._book.outbox.last:
            OperatorSession._do(self, lambda: self._deed(update))

    def _deed(self, update: OperatorUpdate) -> None:
        pair, book = (update.i, update.j), self._book
        pixels = [
            (float(p[0]), float(p[1])) for p in (update.pixel_i, update.pixel_j) if p is not None
        ]
        views = [view for view in (update.view_i, update.view_j) if view is not None]
        match update.action, update.correspondence, views, pixels:
            case "add", _, [view_i, view_j], [pixel_i, pixel_j]:
                book.add(view_i, pixel_i, view_j, pixel_j)
            case "move", int(id), _, [pixel_i, pixel_j]:
                before = next((e.pick for e in book.entries(pair) if e.id == id), None)
                side = 0 if before is not None and before.pixel_i != pixel_i else 1
                book.move(pair, id, side, (pixel_i, pixel_j)[side])
            case "erase", int(id), _, _:
                book.erase(pair, id)
            case "clear", _, _, _:
                book.clear(pair)
            case _:
                raise OperatorError(f"update {update.n} cannot be repeated")


class Player:
    """Plays a recording's records in their order, each at its time.

    Args:
        recording: what is played.
        session: of the same recording, with `clock` as its clock.
        clock: the time of the recording.
    """

    def __init__(self, recording: Recording, session: PlayedSession, clock: PlayClock) -> None:
        self._recording = recording
        self._session = session
        self._clock = clock
        self._keys = Keys(recording.site)
        self._intake = Intake(session, self._keys)
        self._changed = threading.Condition()
        self._until_s = 0.0  # what lies before it is played at once

    @property
    def seconds(self) -> float:
        """How long the recording is."""
        return self._recording.seconds

    @property
    def at_s(self) -> float:
        """Where it stands."""
        return min(self._clock(), self.seconds)

    @property
    def paused(self) -> bool:
        return self._clock.paused

    def toggle(self) -> None:
        """Stands still, or goes on."""
        with self._changed:
            self._clock.set(self._clock(), not self._clock.paused)
            self._changed.notify_all()

    def skip_to(self, at_s: float) -> None:
        """Plays at once what lies before a later moment."""
        with self._changed:
            self._until_s = max(self._until_s, at_s)
            self._changed.notify_all()

    def run(self, stop: threading.Event | None = None, paused: bool = False) -> None:
        """Plays to the end, or until told to stop.

        Args:
            stop: ends it.
            paused: stand still, once what is to be skipped is played.

        Raises:
            RecordingError: the file cannot be read any more.
        """
        stop = stop or threading.Event()
        self._clock.set(0.0, paused)
        for record in self._recording:
            self._wait(record.at_s, stop)
            if stop.is_set():
                return
            self.play(record)
        self._clock.set(self.seconds, paused=True)

    def play(self, record: Record) -> None:
        """Plays one record; what could not be used then cannot be now, and is counted again."""
        try:
            self._do(record.way, record.sample)
        except FleetPoseError as error:
            self._session.drop(record.sample.key, error)
        self._session.open_updates()  # nobody sends them, but one that was held may be let go

    def _wait(self, at_s: float, stop: threading.Event) -> None:
        with self._changed:
            while not stop.is_set():
                left_s = at_s - self._clock()
                if at_s <= self._until_s:
                    if left_s > 0:
                        self._clock.set(at_s, self._clock.paused)
                    return
                if left_s <= 0 and not self._clock.paused:
                    return
                nap_s = 0.2 if self._clock.paused else min(left_s / self._clock.speed, 0.2)
                self._changed.wait(nap_s)

    def _do(self, way: str, sample: Sample) -> None:
        session = self._session
        match way, sample.encoding:
            case "in", _:
                self._intake.tell(self._intake.open(sample).content)
            case "answer", encoding if encoding == encoding_of(KeptView):
                self._answered(unpack(KeptView, sample.payload))
            case "out", encoding if encoding == encoding_of(Selection):
                session.follow(unpack(Selection, sample.payload))
            case "out", encoding if encoding == encoding_of(OperatorUpdate):
                session.repeat(unpack(OperatorUpdate, sample.payload))
            case _:
                pass

    def _answered(self, kept: KeptView) -> None:
        """A view that the operator's client had asked for."""
        session, view = self._session, kept.view
        if kept.jpeg is None:
            session.on_depths(Depths.of(view))
            return
        header = kept.image or ImageHeader(view=view.name, stamp_ns=view.stamp_ns)
        picture = checked_picture(header, kept.jpeg, view.camera, session.clock())
        if view.name in session.wanted_pictures():
            session.on_fetched(picture)
        else:
            session.on_picture(picture)


def _sent(recording: Recording, kind: type[M]) -> Iterator[M]:
    """What the operator's client has sent of one kind."""
    for record in recording:
        if record.way == "out" and record.sample.encoding == encoding_of(kind):
            with suppress(FleetPoseError):
                yield unpack(kind, record.sample.payload)
