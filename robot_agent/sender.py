"""The way out: frame -> salient points -> view -> wire, in one thread of its own.

A frame waits in a slot for one; a newer one takes its place. So the robot's program never waits,
neither for the computer nor for the network, and what is sent is the newest there is. One view at a
time is on its way, and holds what the link carries within a second; the next one is made ready
meanwhile.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    Camera,
    CameraAnnouncement,
    ImageHeader,
    KeptView,
    View,
    ViewName,
)
from fleetpose.protocol.messages.fields import Clock
from fleetpose.protocol.text import release
from fleetpose.protocol.transport import ENCODING_JPEG, Answer, Link
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of
from fleetpose.robot_agent.on_way import SLOW_S, OnWay
from fleetpose.robot_agent.recent_views import JPEG_QUALITY, KeptViews, kept_view

log = logging.getLogger(__name__)

CAPABILITIES = ("cloud", "image", "view", "odometry")
CLOSE_TIMEOUT_S = 1.0


@dataclass(frozen=True)
class SenderSettings:
    """What is computed, sent and kept.

    Attributes:
        rate_hz: how often frames are meant to come; announced with the camera.
        max_salient: salient points per view, at most.
        jpeg_quality: 1 to 100.
        keep_views: so many of the last views can be asked for.
        clock: whose time the stamps of frames are of; announced with the camera.
    """

    rate_hz: float = 1.0
    max_salient: int = 1600
    jpeg_quality: int = JPEG_QUALITY
    keep_views: int = 30
    clock: Clock = "live"


class Sender:
    """Publishes the frames of one robot and answers for its last views.

    Args:
        link: the session.
        keys: of the site.
        name: the robot's.
        epoch: of its present life.
        settings: what is computed, sent and kept.
        listens: whether a server is there that confirms views; without one none is waited for.
    """

    def __init__(
        self,
        link: Link,
        keys: Keys,
        name: str,
        epoch: str,
        settings: SenderSettings | None = None,
        listens: Callable[[], bool] = lambda: False,
    ) -> None:
        self._name = name
        self._epoch = epoch
        self._settings = settings or SenderSettings()
        self._announcement = link.latched(keys.camera(name))
        self._cloud = link.bulk(keys.cloud(name))
        self._image = link.bulk(keys.image(name), background=True)
        self._kept = KeptViews(epoch, self._settings.keep_views)
        self._on_way = OnWay()
        self._encode_s = 0.0  # what the last view took to be made ready
        self._listens = listens
        self._announced: Camera | None = None
        self._made: tuple[Frame, KeptView] | None = None
        self._changed = threading.Condition()
        self._slot: tuple[ViewName, Frame] | None = None
        self._busy = False
        self._closed = False
        self._failure: Exception | None = None
        self.dropped = 0
        link.queryable(keys.view(name), self._answer)
        self._thread = threading.Thread(target=self._run, name=f"sender {name}", daemon=True)
        self._thread.start()

    def announce(self, camera: Camera) -> None:
        """Publishes the camera model, latched."""
        self._announced = camera
        announcement = CameraAnnouncement(
            robot=self._name,
            epoch=self._epoch,
            camera=camera,
            rate_hz=self._settings.rate_hz,
            capabilities=CAPABILITIES,
            version=release(),
            clock=self._settings.clock,
        )
        self._announcement.put(pack(announcement), encoding_of(CameraAnnouncement))

    def send(self, name: ViewName, frame: Frame) -> None:
        """Hands a frame over; one that still waits is dropped for it."""
        with self._changed:
            if self._failure is not None:
                raise self._failure
            if self._slot is not None:
                self._note_dropped(self._slot[0])
            self._slot = (name, frame)
            self._changed.notify_all()

    def confirm(self, seq: int, waited_s: float = 0.0) -> None:
        """The server has a view, which lay there for some time until it said so."""
        with self._changed:
            changed = self._on_way.confirmed(seq, waited_s, time.monotonic())
            took_s, share = self._on_way.took_s, self._on_way.budget.share
            self._changed.notify_all()
        if changed:
            log.info("link name=%s view_s=%.1f share=%.3g", self._name, took_s, share)

    def unheard_s(self) -> float:
        """For how long views have been sent of which the server has none; 0 where it has them."""
        with self._changed:
            since_s = self._on_way.silent_since_s
        return 0.0 if since_s is None else time.monotonic() - since_s

    def heard_age_s(self) -> float | None:
        """How long ago the server confirmed a view, None before the first."""
        with self._changed:
            at_s = self._on_way.confirmed_s
        return None if at_s is None else time.monotonic() - at_s

    def flush(self, timeout_s: float) -> bool:
        """Waits until no frame waits and none is worked on."""
        with self._changed:
            idle = self._changed.wait_for(
                lambda: self._failure or (self._slot is None and not self._busy), timeout_s
            )
            if self._failure is not None:
                raise self._failure
            return bool(idle)

    def close(self) -> None:
        """Ends the thread after the frame it works on; a frame that waits is dropped."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        while (job := self._next()) is not None:
            try:
                kept = self._make_ready(*job)
                if self._wait_for_link():
                    self._publish(kept)
                elif not self._closed:
                    self._note_dropped(kept.view.name)
            except FleetPoseError as error:
                self.dropped += 1
                log.warning("view dropped name=%s reason=%s", job[0], error)
            except Exception as error:  # a bug: handed to whoever pushes next, who ends with it
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                return

    def _next(self) -> tuple[ViewName, Frame] | None:
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            while not self._closed:
                wait_s = self._begins_in_s()
                if wait_s == 0.0:
                    job, self._slot = self._slot, None
                    self._busy = True
                    return job
                self._changed.wait(wait_s)
            return None

    def _begins_in_s(self) -> float | None:
        """In how long the frame that waits is to be made ready, as far as is known now: so that it
        is when the link is free, and no sooner. None without one.
        """
        if self._slot is None:
            return None
        self._on_way.waits = self._listens()
        now_s = time.monotonic()
        self._on_way.note_overdue(now_s)
        return self._on_way.expected_free_in_s(now_s + self._encode_s)

    def _wait_for_link(self) -> bool:
        """Waits until the link is free for what is ready; false if a newer frame came before, or
        the end.
        """
        with self._changed:
            while not self._closed:
                self._on_way.waits = self._listens()
                wait_s = self._on_way.free_in_s(time.monotonic())
                if wait_s == 0.0:
                    return True
                if self._slot is not None:
                    return False
                self._changed.wait(wait_s)
            return False

    def _note_dropped(self, name: ViewName) -> None:
        self.dropped += 1
        log.info("view dropped name=%s reason=newer", name)

    def _make_ready(self, name: ViewName, frame: Frame) -> KeptView:
        start_s = time.monotonic()
        if self._announced is None or pack(self._announced) != pack(frame.model):
            self.announce(frame.model)
        kept = self._again(name, frame) or self._encoded(name, frame)
        self._made = frame, kept
        self._encode_s = time.monotonic() - start_s
        return kept

    def _publish(self, kept: KeptView) -> None:
        took_s = self._of_link()["on_way_s"]  # of the view before, which was on its way just now
        view = kept.view.model_copy(update={"on_way_s": took_s})
        kept = kept.model_copy(update={"view": view})
        self._kept.keep(kept)
        payload = pack(view)
        put_s, size = time.monotonic(), len(payload)
        with self._changed:
            self._on_way.sent(view.name.seq, put_s, size, len(view.salient.data) / size)
        self._cloud.put(payload, encoding_of(View))
        image_bytes = self._publish_image(kept)
        log.info(
            "view name=%s salient=%d bytes=%d image_bytes=%d encode_ms=%.1f put_ms=%.1f",
            view.name,
            view.salient.count,
            size,
            image_bytes,
            1e3 * self._encode_s,
            1e3 * (time.monotonic() - put_s),
        )

    def _encoded(self, name: ViewName, frame: Frame) -> KeptView:
        settings, budget = self._settings, self._on_way.budget
        salient = salient_of(frame, budget.points(settings.max_salient))
        view = view_of(name, frame, salient).model_copy(update=self._of_link())
        return kept_view(view, frame.image, budget.quality(settings.jpeg_quality))

    def _of_link(self) -> dict[str, float]:
        """What a view tells of the link."""
        with self._changed:
            return {"on_way_s": self._on_way.took_s, "share": self._on_way.budget.share}

    def _again(self, name: ViewName, frame: Frame) -> KeptView | None:
        """The last view under a new name and stamp, where nothing in sight has changed since, and
        the link carries as much as then.
        """
        if self._made is None:
            return None
        before, kept = self._made
        of_link = self._of_link()
        if frame.ranges is not before.ranges or frame.model is not before.model:
            return None
        if kept.view.share != of_link["share"]:
            return None
        now = {"name": name, "stamp_ns": frame.stamp_ns, **of_link}
        up = {"up_camera": frame.up_camera, "up_sigma_rad": frame.up_sigma_rad}
        view = kept.view.model_copy(update={**now, **up, "frozen_s": frame.frozen_s})
        header = ImageHeader(view=name, stamp_ns=frame.stamp_ns)
        return kept.model_copy(update={"view": view, "image": header})

    def _answer(self, parameters: dict[str, str]) -> Answer:
        """What of the last views is asked for, unless it would hold up the next ones: who asks does
        not wait that long anyway.
        """
        answer = self._kept.answer(parameters)
        with self._changed:
            takes_s = self._on_way.takes_s(len(answer.payload))
        if takes_s > SLOW_S:
            return Answer(error=f"the link is slow: it would take {takes_s:.1f} s and more")
        return answer

    def _publish_image(self, kept: KeptView) -> int:
        if not self._image.wanted or kept.jpeg is None or kept.image is None:
            return 0
        with self._changed:
            if not self._on_way.image_may_go(len(kept.jpeg), time.monotonic()):
                return 0
        self._image.put(kept.jpeg, ENCODING_JPEG, attachment=pack(kept.image))
        return len(kept.jpeg)
