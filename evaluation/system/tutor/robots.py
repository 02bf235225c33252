"""The robots of a recording, alive again: they send what they sent, and then stand still."""

import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path

from fleetpose.evaluation.bench.replay.inputs import heard, site_recording
from fleetpose.evaluation.simulate.replay_robots import ReplayedRobot
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import ImageHeader, KeptView, View, ViewName
from fleetpose.protocol.recording.file import Recording, RecordingError
from fleetpose.protocol.transport import ENCODING_JPEG, Link
from fleetpose.robot_agent.sender import SenderSettings

_STANDING_S = 1.0  # between views of a robot that stands still
_REMEMBERED = 600  # views of a robot that points may be about


def robots_in(path: Path) -> tuple[Recording, tuple[str, ...]]:
    """A recording, and its robots that have views with images.

    Raises:
        RecordingError: it cannot be read, is no site's, or has fewer than two such robots.
    """
    recording = site_recording(path)
    robots = {kept.view.name.robot for _, kept in views_of(recording)}
    if len(robots) < 2:
        raise RecordingError(
            f"{path} has {len(robots)} robots with images, and it takes two to click: record with "
            "'pose-server record' while images come"
        )
    return recording, tuple(sorted(robots))


def views_of(recording: Recording) -> Iterator[tuple[float, KeptView]]:
    """Views with their images, at their seconds; those that came without an image are left out."""
    views: dict[str, View] = {}
    images: dict[str, tuple[bytes, ImageHeader]] = {}
    for record in heard(recording, Keys(recording.site)):
        sample = record.sample
        try:
            if sample.encoding == encoding_of(View):
                view = unpack(View, sample.payload)
                robot = view.name.robot
                views[robot] = view
            elif sample.encoding == ENCODING_JPEG and sample.attachment is not None:
                header = unpack(ImageHeader, sample.attachment)
                robot = header.view.robot
                images[robot] = sample.payload, header
            else:
                continue
        except CodecError:
            continue  # damaged already when it was recorded
        if robot in views and robot in images and images[robot][1].view == views[robot].name:
            jpeg, header = images.pop(robot)
            yield record.at_s, KeptView(view=views.pop(robot), jpeg=jpeg, image=header)


class Robots:
    """Plays a recording's robots in a thread of its own; use it in a `with`.

    Args:
        recording: of a site.
        link: closed by who opened it, after this.
        keys: of the site that they live in now.
        speed: times as fast as recorded.

    Attributes:
        ended: everything has been played; all stand still.
    """

    def __init__(self, recording: Recording, link: Link, keys: Keys, speed: float = 1.0) -> None:
        self.ended = threading.Event()
        self._failure: Exception | None = None
        self._recording, self._link, self._keys, self._speed = recording, link, keys, speed
        self._robots: dict[str, ReplayedRobot] = {}
        self._last: dict[str, tuple[float, KeptView]] = {}
        self._shown: dict[ViewName, KeptView] = {}
        self._order: dict[str, deque[ViewName]] = {}
        self._lock, self._stop = threading.Lock(), threading.Event()
        self._thread = threading.Thread(name="tutor robots", target=self._guarded, daemon=True)

    def __enter__(self) -> "Robots":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def recorded(self, name: ViewName) -> KeptView | None:
        """What a robot showed under a name, as it was recorded."""
        with self._lock:
            return self._shown.get(name)

    def check(self) -> None:
        """Raises what ended the playing before its time."""
        if self._failure is not None:
            raise self._failure

    def _guarded(self) -> None:
        try:
            self._run()
        except Exception as error:  # ends the lesson, which tells it
            self._failure = error

    def _run(self) -> None:
        began_s = time.monotonic()
        for at_s, kept in views_of(self._recording):
            while time.monotonic() < began_s + at_s / self._speed:
                if self._stop.wait(0.05):
                    return
                self._stand()
            self._show(kept)
        self.ended.set()
        while not self._stop.wait(0.05):
            self._stand()

    def _stand(self) -> None:
        """Who has nothing new shows the same again."""
        for shown_s, kept in list(self._last.values()):
            if time.monotonic() > shown_s + _STANDING_S:
                self._show(kept)

    def _show(self, kept: KeptView) -> None:
        robot = kept.view.name.robot
        if robot not in self._robots:
            settings = SenderSettings(rate_hz=1 / _STANDING_S)
            self._robots[robot] = ReplayedRobot(self._link, self._keys, robot, kept, settings)
        name = self._robots[robot].show(kept)
        self._last[robot] = time.monotonic(), kept
        with self._lock:
            self._shown[name] = kept
            order = self._order.setdefault(robot, deque())
            order.append(name)
            if len(order) > _REMEMBERED:
                del self._shown[order.popleft()]
