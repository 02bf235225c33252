"""The small topics of a robot, odometry and joints: kept as they come, read when a frame needs
them.
"""

import threading
from collections import deque

from fleetpose.protocol.errors import CodecError
from fleetpose.robot_agent.cameras.ros.network import RosNetwork
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.rosmsg.bag import Recorded
from fleetpose.rosmsg.dialects.rmw_zenoh import Endpoint
from fleetpose.rosmsg.odometry import NEAR_NS
from fleetpose.rosmsg.roles import HEADED
from fleetpose.rosmsg.stamps import header_ns

_KEPT = 400  # messages of a topic: two seconds at 200 Hz
_LATER_S = 0.1  # so long an image waits for the odometry that comes after it


class Following:
    """What a sensor's small topics say.

    Args:
        network: where they are.
        sensor: to be told.
        endpoints: of its followed topics.
    """

    def __init__(self, network: RosNetwork, sensor: Sensor, endpoints: list[Endpoint]) -> None:
        self._network, self._sensor = network, sensor
        self._changed = threading.Condition()
        self._kept = {one.topic: deque[Recorded](maxlen=_KEPT) for one in endpoints}
        self._leave = [network.subscribe(one, self._store) for one in endpoints]

    def tell(self, stamp_ns: int) -> None:
        """Tells the sensor what was said around a moment; waits a little for what follows it."""
        odometry = self._sensor.roles.odometry
        if odometry in self._kept:
            with self._changed:
                self._changed.wait_for(lambda: self._reaches(odometry, stamp_ns), _LATER_S)
        for topic, kept in self._kept.items():
            messages = self._drained(kept)
            for message in messages:
                if _is_near(message, stamp_ns):
                    self._note(topic, message)

    def close(self) -> None:
        """Leaves them."""
        for leave in self._leave:
            leave()

    def _store(self, message: Recorded) -> None:
        with self._changed:
            self._kept[message.topic].append(message)
            self._changed.notify()

    def _reaches(self, topic: str, stamp_ns: int) -> bool:
        kept = self._kept[topic]
        try:
            return bool(kept) and header_ns(kept[-1]) >= stamp_ns
        except CodecError:
            return True

    def _drained(self, kept: deque[Recorded]) -> list[Recorded]:
        with self._changed:
            messages = list(kept)
            kept.clear()
            kept.extend(messages[-1:])  # it may be the one before the next moment
        return messages

    def _note(self, topic: str, message: Recorded) -> None:
        read = self._network.read(message)
        if read is None:
            return
        try:
            self._sensor.note(topic, read)
        except CodecError as error:
            self._network.drops.note(topic, error)


def _is_near(message: Recorded, stamp_ns: int) -> bool:
    """Joints have a stamp each: all are read."""
    if message.kind.name not in HEADED:
        return True
    try:
        return abs(header_ns(message) - stamp_ns) <= 3 * NEAR_NS
    except CodecError:
        return True  # is read, refused and counted
