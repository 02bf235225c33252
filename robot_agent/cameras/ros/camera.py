"""A robot that runs ROS 2 as a camera: one pair of messages at a time, each when it is asked for.

Drivers publish thirty pairs a second and the fleet needs one. So both topics are subscribed to for
the moment of one pair, and what is not asked for does not cross the robot's network.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from fleetpose.protocol.errors import CodecError, EndpointError
from fleetpose.protocol.keys import checked_endpoint
from fleetpose.protocol.session.opening import FOR_EVER
from fleetpose.protocol.transport import Link, SessionSettings, open_session
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.ros.finding import RobotTopics, find
from fleetpose.robot_agent.cameras.ros.following import Following
from fleetpose.robot_agent.cameras.ros.network import RosNetwork
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.rosmsg.bag import Recorded
from fleetpose.rosmsg.stamps import Moment, Pairing, header_ns

log = logging.getLogger(__name__)

SILENT_S = 3.0
_LOOK_S = 0.5
_FIRST_TOLD_S, _TOLD_EVERY_S = 10.0, 60.0


class RosCamera:
    """A robot's camera.

    Args:
        network: where its topics are.
        source: those topics.
        sensor: what they are.
        stop: ends the waiting for the next frame.
        waiting: is told, while a topic is silent, which it is.
    """

    def __init__(
        self,
        network: RosNetwork,
        source: RobotTopics,
        sensor: Sensor,
        stop: threading.Event | None = None,
        waiting: Callable[[str], None] = lambda status: None,
    ) -> None:
        self.network, self.sensor = network, sensor
        self._stop = stop or threading.Event()
        self._waiting = waiting
        self._streams = [source.endpoints[topic] for topic in sensor.streams]
        followed = [source.endpoints[topic] for topic in sorted(sensor.followed)]
        network.show([*self._streams, *followed])
        self._following = Following(network, sensor, followed)
        self._taken = _Taken(network)

    def frames(self) -> Iterator[Frame]:
        """Frames of now, until it is stopped."""
        while (moment := self._moment()) is not None:
            if (frame := self._frame(moment)) is not None:
                self._taken.note(moment)
                yield frame

    def close(self) -> None:
        self._following.close()
        self.network.close()

    def _moment(self) -> Moment[Recorded] | None:
        """The next two messages that belong together; None when it is stopped."""
        pairing: Pairing[Recorded] = Pairing(2, self.sensor.max_skew_ns)
        heard = _Heard(self.sensor.streams)
        with self.network.subscribed(self._streams) as arrivals:
            while not self._stop.is_set():
                message = arrivals.take(_LOOK_S)
                if silent := heard.note(message):
                    self._waiting(silent)
                if message is None:
                    continue
                for moment in self._paired(pairing, message):
                    heard.end()
                    return moment
        return None

    def _paired(self, pairing: Pairing[Recorded], message: Recorded) -> Iterator[Moment[Recorded]]:
        try:
            stamp_ns = header_ns(message)
        except CodecError as error:
            self.network.drops.note(message.topic, error)
            return
        yield from pairing.add(self.sensor.streams.index(message.topic), stamp_ns, message)

    def _frame(self, moment: Moment[Recorded]) -> Frame | None:
        image, ranges = (self.network.read(message) for message in moment.items)
        if image is None or ranges is None:
            return None
        self._following.tell(moment.stamp_ns)
        try:
            frame = self.sensor.frame(image, ranges, moment.stamp_ns)
        except CodecError as error:
            self.network.drops.note(self.sensor.roles.image, error)
            return None
        return replace(frame, raw=(frame.image,))


class _Heard:
    """Which of the streams say something while a pair is waited for, and since when not."""

    def __init__(self, topics: tuple[str, str]) -> None:
        self._last_s = dict.fromkeys(topics, time.monotonic())
        self._told = ""

    def note(self, message: Recorded | None) -> str:
        """A message came, or none for a while; says what is silent, empty where nothing is."""
        now_s = time.monotonic()
        if message is not None:
            self._last_s[message.topic] = now_s
        silent = [topic for topic, at_s in self._last_s.items() if now_s - at_s > SILENT_S]
        if silent and not self._told:
            self._told = ", ".join(silent)
            log.warning(
                "silent topics=%s for %.0f s: does its driver run? It is waited for",
                *(self._told, SILENT_S),
            )
        return f"silent: {', '.join(silent)}" if silent else ""

    def end(self) -> None:
        """A pair has come."""
        if self._told:
            log.info("heard again topics=%s", self._told)


class _Taken:
    """Tells now and then how much is taken from the robot."""

    def __init__(self, network: RosNetwork) -> None:
        self._network = network
        self._since_s, self._bytes, self._pairs = time.monotonic(), network.taken_bytes, 0
        self._every_s = _FIRST_TOLD_S

    def note(self, moment: Moment[Recorded]) -> None:
        self._pairs += 1
        seconds = time.monotonic() - self._since_s
        if seconds < self._every_s:
            return
        megabytes = 1e-6 * (self._network.taken_bytes - self._bytes)
        log.info(
            "took pairs=%d mb_per_s=%.2f skew_ms=%.1f age_ms=%.0f dropped=%d",
            *(self._pairs, megabytes / seconds, 1e-6 * moment.skew_ns),
            *(1e-6 * (time.time_ns() - moment.stamp_ns), sum(self._network.drops.values())),
        )
        self._since_s, self._bytes = time.monotonic(), self._network.taken_bytes
        self._pairs, self._every_s = 0, _TOLD_EVERY_S


def open_camera(
    source: str,
    replay: str,
    calibration: Path | None = None,
    ros: RosOptions | None = None,
    stop: threading.Event | None = None,
    translation_unit: float | None = None,
    waiting: Callable[[str], None] = lambda status: None,
) -> RosCamera:
    """Opens a robot as a camera; waits for its router.

    Args:
        source: the endpoint of its router, `tcp/ROBOT:7447`.
        replay: of no meaning for a live camera.
        calibration: in place of its infos.
        ros: which topics.
        stop: ends all waiting.
        translation_unit: metres that one of the calibration's translation is; None: metres.
        waiting: is told what is waited for.

    Raises:
        EndpointError: the source is no endpoint.
        CameraError: there is no camera among its topics.
        EndedError: the waiting was ended.
    """
    del replay
    options, stop = ros or RosOptions(), stop or threading.Event()
    network = open_network(source, options.domain, stop, waiting)
    try:
        topics = RobotTopics(source, network, options.namespace)
        sensor = find(topics, options, calibration, translation_unit, stop, waiting)
        camera = RosCamera(network, topics, sensor, stop, waiting)
    except BaseException:
        network.close()
        raise
    roles = sensor.roles
    log.info(
        "ros form=%s image=%s ranges=%s odometry=%s",
        *(roles.form, roles.image, roles.ranges, roles.odometry),
    )
    if sensor.mounting.why_not:
        log.warning(
            "%s: the camera is taken to stand at the robot's origin and to look ahead: %s",
            *(source, sensor.mounting.why_not),
        )
    return camera


def open_network(
    endpoint: str,
    domain: int,
    stop: threading.Event,
    waiting: Callable[[str], None] = lambda status: None,
    timeout_s: float = FOR_EVER,
) -> RosNetwork:
    """Joins a robot's network by its router.

    Raises:
        EndpointError: it is no endpoint.
        UnreachableError: no router answers in time.
        EndedError: the waiting was ended.
    """
    where = tuple(checked_endpoint(one) for one in endpoint.split(",") if one)
    if not where:
        raise EndpointError("give --data: the endpoint of the robot's router, e.g. tcp/r1:7447")
    link = Link(open_session(SessionSettings(where, (), None, timeout_s, stop, waiting)))
    return RosNetwork(link, domain)
