"""Robots that replay views which a real agent would send: load at rates at which two cores could
not find salient points as well.

All of them live in one process. Each shows itself, announces its camera, publishes and answers for
its last views as an agent does; only the views are made once, before the first is sent.
"""

import signal
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import islice

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from fleetpose.protocol.keys import Keys, new_epoch
from fleetpose.protocol.messages import CameraAnnouncement, ImageHeader, KeptView, View, ViewName
from fleetpose.protocol.presence import Presence
from fleetpose.protocol.transport import (
    ENCODING_JPEG,
    Link,
    SessionSettings,
    open_session,
    wait_until,
)
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.kinds import CameraKind
from fleetpose.robot_agent.features.keypoints import salient_points
from fleetpose.robot_agent.features.packing import view_of
from fleetpose.robot_agent.recent_views import KeptViews, kept_view
from fleetpose.robot_agent.sender import SenderSettings


@dataclass(frozen=True)
class Source:
    """One robot: its name and where its views come from."""

    name: str
    camera: CameraKind
    data: str

    @classmethod
    def parse(cls, text: str) -> "Source":
        """From `NAME,CAMERA,DATA`.

        Raises:
            FleetPoseError: it is not of that form.
        """
        parts = text.split(",", 2)
        if len(parts) != 3:
            raise FleetPoseError(f"'{text}' is no robot: write NAME,CAMERA,DATA")
        return cls(*parts)  # type: ignore[arg-type]


def run(
    sources: Sequence[Source], connect: tuple[str, ...], site: str, rate_hz: float, frames: int
) -> None:
    """Replays until SIGTERM or SIGINT.

    Args:
        sources: the robots.
        connect: endpoints of the router.
        rate_hz: of each robot.
        frames: so many of each camera's first frames are shown in turn, forward and backward.

    Raises:
        FleetPoseError: a camera or the router cannot be had.
    """
    stop = stop_at_signals()
    settings = SenderSettings(rate_hz=rate_hz)
    recorded = {source.name: _record(source, frames, settings) for source in sources}
    with ExitStack() as closing:
        link = Link(open_session(SessionSettings(connect=connect)))
        closing.callback(link.close)
        robots = [
            (ReplayedRobot(link, Keys(site), n, views[0], settings), _back_and_forth(views))
            for n, views in recorded.items()
        ]
        began_s, turn = time.monotonic(), 0
        while not stop.is_set():
            for k, (robot, order) in enumerate(robots):
                due_s = began_s + (turn + k / len(robots)) / rate_hz  # not all in one moment
                wait_until(lambda due_s=due_s: stop.is_set() or time.monotonic() >= due_s, 60.0)
                robot.show(next(order))
            turn += 1


def stop_at_signals() -> threading.Event:
    """An event that SIGTERM and SIGINT set from now on."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    return stop


def _record(source: Source, frames: int, settings: SenderSettings) -> list[KeptView]:
    """Views and JPEGs of a camera's first frames, named like the first of a life."""
    camera = open_camera(source.camera, source.data, "once")
    try:
        views = [_encoded(frame, settings) for frame in islice(camera.frames(), frames)]
    finally:
        camera.close()
    if not views:
        raise DataFolderError(f"{source.data} shows nothing")
    return views


def _encoded(frame: Frame, settings: SenderSettings) -> KeptView:
    salient = salient_points(frame.image, frame.ranges, frame.model, settings.max_salient)
    name = ViewName(robot="recorded", epoch="0" * 12, seq=0)
    return kept_view(view_of(name, frame, salient), frame.image, settings.jpeg_quality)


class ReplayedRobot:
    """One robot that shows views that were made before.

    Args:
        link: of the process; closed by who opened it.
        keys: of the site.
        name: of the robot.
        first: any of its views; its camera is announced.
        settings: how often views are meant to come, and how many can be asked for.
    """

    def __init__(
        self, link: Link, keys: Keys, name: str, first: KeptView, settings: SenderSettings
    ) -> None:
        self._name, self._epoch, self._seq = name, new_epoch(), 0
        self._kept = KeptViews(self._epoch, settings.keep_views)
        self._presence = Presence(
            link,
            everybody=keys.robot_alive(name, "*"),
            mine=keys.robot_alive(name, self._epoch),
            who=f"a robot named '{name}'",
            remedy="end it",
        )
        announced = CameraAnnouncement(
            robot=name, epoch=self._epoch, camera=first.view.camera, rate_hz=settings.rate_hz
        )
        link.latched(keys.camera(name)).put(pack(announced), encoding_of(CameraAnnouncement))
        self._cloud = link.bulk(keys.cloud(name))
        self._image = link.bulk(keys.image(name), background=True)
        link.queryable(keys.view(name), self._kept.answer)

    def show(self, shown: KeptView) -> ViewName:
        """Publishes a view that has an image, as one of now; returns its new name."""
        name = ViewName(robot=self._name, epoch=self._epoch, seq=self._seq)
        self._seq += 1
        view = shown.view.model_copy(update={"name": name, "stamp_ns": time.time_ns()})
        assert shown.jpeg is not None
        image = ImageHeader(view=name, stamp_ns=view.stamp_ns)
        self._kept.keep(KeptView(view=view, jpeg=shown.jpeg, image=image))
        self._cloud.put(pack(view), encoding_of(View))
        if self._image.wanted:
            self._image.put(shown.jpeg, ENCODING_JPEG, attachment=pack(image))
        return name


def _back_and_forth(views: list[KeptView]) -> Iterator[KeptView]:
    while True:
        yield from views
        yield from reversed(views[1:-1])
