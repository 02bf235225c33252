"""What a robot's topics are: looked at once, at the start, before anything is sent."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from fleetpose.protocol.errors import EndedError, FleetPoseError
from fleetpose.robot_agent.cameras.base import CameraError
from fleetpose.robot_agent.cameras.ros.network import RosNetwork
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.rosmsg.bag import Recorded, Topic
from fleetpose.rosmsg.dialects.rmw_zenoh import Endpoint
from fleetpose.rosmsg.roles import CLOUD, HEADED, IMAGES, TF, is_below
from fleetpose.rosmsg.transforms import KEPT

log = logging.getLogger(__name__)

FOUND_WITHIN_S = 10.0
LOOK_S = 2.0  # for the first message of each topic
_MOVING_S = 0.5  # for joints that move: at 10 Hz some of each
_SETTLE_S = 0.3  # for tokens to come
_MOST_SHOWN = 30  # topics that an error lists


class RobotTopics:
    """A robot as a `TopicSource`: the first messages of its topics, which are asked for once.

    Args:
        name: for errors.
        network: where it is.
        namespace: of its topics.

    Attributes:
        endpoints: its topics, and those of tf.
        counts: messages that came while they were looked at.
    """

    what = "the robot"

    def __init__(self, name: str, network: RosNetwork, namespace: str) -> None:
        self.name = name
        self._network, self._namespace = network, namespace
        self.endpoints: dict[str, Endpoint] = {}
        self.counts: dict[str, int] = {}
        self.seconds = 0.0
        self._firsts: dict[str, Recorded] = {}
        self._tf: dict[str, list[Recorded]] = {}

    @property
    def topics(self) -> Sequence[Topic]:
        """Those that are needed count only if a message of them came."""
        return tuple(
            Topic(name, one.type, self.counts.get(name, 0)) for name, one in self.endpoints.items()
        )

    @property
    def silent(self) -> list[str]:
        """Topics that could be needed, have a publisher, and say nothing."""
        return [one.topic for one in self._wanted() if one.topic not in self.counts]

    def look(self, within_s: float = LOOK_S, whole: bool = False) -> None:
        """Waits for a message of every topic that could be needed, but no longer than told.

        Args:
            within_s: how long at most.
            whole: whether all of them are listened to for that long, to count.
        """
        self.endpoints = {
            name: one
            for name, one in self._network.endpoints().items()
            if is_below(name, self._namespace) or one.type in TF
        }
        wanted = self._wanted()
        missing = [one for one in wanted if whole or one.type in TF or one.topic not in self.counts]
        hide = self._network.show(missing)
        began_s = time.monotonic()
        with self._network.subscribed(missing) as arrivals:
            while (left_s := began_s + within_s - time.monotonic()) > 0:
                if not (whole or self.silent) and time.monotonic() - began_s > _MOVING_S:
                    break
                message = arrivals.take(min(left_s, 0.1))
                if message is not None:
                    self._note(message)
        self.seconds = time.monotonic() - began_s
        hide()

    def first(self, topic: str) -> Any | None:
        """See `TopicSource`."""
        message = self._firsts.get(topic)
        return None if message is None else self._network.read(message)

    def transforms(self, topic: str) -> Iterator[Any]:
        """See `TopicSource`."""
        for message in self._tf.get(topic, ()):
            if (read := self._network.read(message)) is not None:
                yield read

    def _wanted(self) -> list[Endpoint]:
        kinds = (*IMAGES, *HEADED, CLOUD, *TF)
        return [one for one in self.endpoints.values() if one.type in kinds]

    def _note(self, message: Recorded) -> None:
        self.counts[message.topic] = self.counts.get(message.topic, 0) + 1
        self._firsts.setdefault(message.topic, message)
        if message.kind.name in TF and len(kept := self._tf.setdefault(message.topic, [])) < KEPT:
            kept.append(message)


def find(
    source: RobotTopics,
    options: RosOptions,
    calibration: Path | None,
    translation_unit: float | None,
    stop: threading.Event,
    waiting: Callable[[str], None],
) -> Sensor:
    """The camera of a robot, once its topics say enough.

    Raises:
        CameraError: they do not in time; it says which there are, and what is missing.
        EndedError: the waiting was ended.
    """
    end_s = time.monotonic() + FOUND_WITHIN_S
    stop.wait(_SETTLE_S)
    while not stop.is_set():
        waiting("looking at the robot's topics")
        source.look()
        late = time.monotonic() > end_s
        try:
            sensor = Sensor(source, options, calibration, translation_unit)
        except FleetPoseError as error:
            if late:
                raise CameraError(_why_not(source, error)) from error
        else:
            if late or not sensor.mounting.why_not or not sensor.roles.tf:
                return sensor
        stop.wait(_SETTLE_S)
    raise EndedError("asked to end while looking at the robot's topics")


def _why_not(source: RobotTopics, error: FleetPoseError) -> str:
    """What is missing, and what is there."""
    names = list(source.endpoints)
    if not names:
        return (
            f"{source.name}: no topics are shown there: do the robot's nodes run rmw_zenoh with "
            "this router (or zenoh-bridge-ros2dds), with this --domain and --namespace?"
        )
    shown = ", ".join(names[:_MOST_SHOWN])
    more = f" and {len(names) - _MOST_SHOWN} more" if len(names) > _MOST_SHOWN else ""
    silent = f"; silent are: {', '.join(source.silent[:_MOST_SHOWN])}" if source.silent else ""
    return f"{source.name}: {error}. There are: {shown}{more}{silent}"
