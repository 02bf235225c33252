"""What a robot that runs publishes: everything that could be needed is listened to for a moment."""

import logging
import shlex
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.robot_agent.cameras.ros.camera import open_network
from fleetpose.robot_agent.cameras.ros.finding import RobotTopics, of_one_robot
from fleetpose.robot_agent.cameras.ros.network import RosNetwork
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.robot_agent.checking.topics import lines
from fleetpose.robot_agent.checking.topics.lines import Seen
from fleetpose.rosmsg.bag import Recorded, Topic
from fleetpose.rosmsg.live.names import name_of
from fleetpose.rosmsg.roles import HEADED
from fleetpose.rosmsg.stamps import Pairing, header_ns

LISTEN_S = 2.0
_SETTLE_S = 0.5
_ROUTER_WITHIN_S = 5.0
_LATE_S = 1.0  # of a robot whose clock is that of this machine


def report(source: str, options: RosOptions, calibration: Path | None) -> Iterator[str]:
    """The lines of the screen.

    Raises:
        UnreachableError: no router is there.
    """
    stop = threading.Event()
    network = open_network(source, options.domain, stop, timeout_s=_ROUTER_WITHIN_S)
    try:
        stop.wait(_SETTLE_S)  # tokens come
        listening = _Listening()
        topics = RobotTopics(source, network, options.namespace)
        topics.look(LISTEN_S, listening.note)
        yield from _table(topics, listening)
        yield from _camera(topics, listening, options, calibration)
        yield from _dropped(network)
    finally:
        network.close()


class _Listening:
    """When messages were taken; of those that may be images or ranges, which belong together."""

    def __init__(self) -> None:
        self.seen: dict[str, Seen] = {}
        self._headed: list[Recorded] = []

    def note(self, message: Recorded) -> None:
        seen = self.seen.setdefault(message.topic, Seen())
        if message.kind.name not in HEADED:
            seen.stamps_ns.append(message.received_ns)
            return
        with suppress(CodecError):  # is counted when it is read
            seen.note_headed(message)
            self._headed.append(message._replace(raw=message.raw[:16]))

    def skew(self, sensor: Sensor) -> str:
        pairing: Pairing[Recorded] = Pairing(2, sensor.max_skew_ns)
        streams, pairs = sensor.streams, 0
        for message in self._headed:
            if message.topic in streams:
                stream = streams.index(message.topic)
                pairs += sum(1 for _ in pairing.add(stream, header_ns(message), message))
        return lines.skew_of(pairing, pairs)


def _table(topics: RobotTopics, listening: _Listening) -> Iterator[str]:
    count = len(topics.endpoints)
    yield f"{topics.name}: {count} topics, listened to for {topics.seconds:.1f} s"
    silent, needed = set(topics.silent), {one.topic for one in topics.wanted}

    def note(topic: Topic) -> str:
        if topic.name not in needed:
            return "  not listened to"
        return "  silent" if topic.name in silent else ""

    yield from lines.table(topics.topics, listening.seen, note)
    if not count:
        yield (
            "  missing     topics: do the robot's nodes run rmw_zenoh with this router (or "
            "zenoh-bridge-ros2dds), with this --domain and --namespace?"
        )


def _camera(
    topics: RobotTopics, listening: _Listening, options: RosOptions, calibration: Path | None
) -> Iterator[str]:
    try:
        of_one_robot(topics, options)
        sensor = Sensor(topics, options, calibration)
    except FleetPoseError as error:
        yield f"  missing     {error}"
        return
    yield from lines.camera(sensor, listening.skew(sensor), calibration is not None)
    late_s = listening.seen[sensor.roles.image].late_s
    if abs(late_s) > _LATE_S:
        yield (
            f"  note        its images come {late_s:.1f} s after they were taken, by their headers "
            "and this machine's clock: do the clocks differ?"
        )
    name = name_of(options.namespace) or "r1"
    run = f"robot-agent run --name {name} --camera ros --data {shlex.quote(topics.name)}"
    yield f"  run it      {lines.command(run, options, calibration)}"


def _dropped(network: RosNetwork) -> Iterator[str]:
    for reason, count in sorted(network.drops.snapshot().items()):
        yield f"  note        {count} dropped: {reason}"
    logging.getLogger(__name__).debug("took %d bytes", network.taken_bytes)
