"""The same bridge where ROS 2 is installed, as a node of rclpy: for whatever middleware runs there.

python -m fleetpose.ros_bridge.node --robot r1=/r1 --connect tcp/SERVER:7447
"""

import importlib
import logging
import queue
import sys
import time
from functools import cache
from importlib.util import find_spec
from typing import Any

from fleetpose.protocol.commands import command_line, require, run_command
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.settings import SettingsFile, with_options
from fleetpose.ros_bridge.settings import BridgeSettings
from fleetpose.ros_bridge.topics import ODOMETRY, TF, Message, Topics, Wanted

log = logging.getLogger("pose-ros")
app = command_line(no_args_is_help=False)

_DEPTH = 100  # messages that wait, as tf2 has it
_LOOK_S = 1.0  # between two looks for new topics


class RclpyTopics:
    """Topics by rclpy. All runs in the thread that takes.

    Args:
        wanted: whether a topic of a type is to be read.
    """

    def __init__(self, wanted: Wanted, drops: Drops) -> None:
        self._rclpy = importlib.import_module("rclpy")
        if not self._rclpy.ok():
            self._rclpy.init()
        self._node = self._rclpy.create_node("fleetpose")
        self._wanted = wanted
        self._waiting: queue.SimpleQueue[Message] = queue.SimpleQueue()
        self._read: dict[str, Any] = {}
        self._written: dict[str, Any] = {}
        self._looked_s = 0.0

    @staticmethod
    def types(type: str) -> Any:
        """The class of a message, e.g. of `geometry_msgs/msg/Pose`."""
        return _class_of(type)

    def take(self, timeout_s: float) -> Message | None:
        """The oldest message that waits, None if none comes in time."""
        self._look()
        if self._waiting.empty():
            self._rclpy.spin_once(self._node, timeout_sec=timeout_s)
        return None if self._waiting.empty() else self._waiting.get()

    def put(self, topic: str, type: str, message: Any, latched: bool = False) -> None:
        """Sends a message on a topic; `latched`: whoever comes late gets it too."""
        if topic not in self._written:
            quality = self._quality(latched)
            self._written[topic] = self._node.create_publisher(_class_of(type), topic, quality)
        self._written[topic].publish(message)

    def _look(self) -> None:
        """Subscribes to what has appeared."""
        if time.monotonic() < self._looked_s + _LOOK_S:
            return
        self._looked_s = time.monotonic()
        for topic, types in self._node.get_topic_names_and_types():
            for type in {TF, ODOMETRY}.intersection(types):
                if topic not in self._read and self._wanted(topic, type):
                    log.info("reads topic=%s type=%s", topic, type)
                    self._read[topic] = self._node.create_subscription(
                        _class_of(type),
                        topic,
                        lambda message, topic=topic, type=type: self._waiting.put(
                            Message(topic, type, message)
                        ),
                        self._quality(topic.endswith("tf_static")),
                    )

    def _quality(self, latched: bool) -> Any:
        qos = importlib.import_module("rclpy.qos")
        durability = qos.DurabilityPolicy
        kept = durability.TRANSIENT_LOCAL if latched else durability.VOLATILE
        return qos.QoSProfile(depth=_DEPTH, durability=kept)


@cache
def _class_of(type: str) -> Any:
    package, kind, name = type.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


@app.command()
@with_options(BridgeSettings)
def node(*, settings: SettingsFile = None, **given: Any) -> None:
    """Joins the robots' tf trees under `fleet` and publishes their poses, as a node of ROS 2."""
    loaded = BridgeSettings.load(settings, given)
    require("ros")
    from fleetpose.ros_bridge.running import run_bridge

    topics: type[Topics] = RclpyTopics
    run_bridge(loaded, topics)


def main() -> None:
    """Runs the node; what a user can mend is one sentence and exit code 2."""
    if find_spec("rclpy") is None:  # it comes with ROS, not by pip
        sys.exit("rclpy is not here: source the setup.bash of ROS 2, or use 'pose-ros bridge'")
    run_command(app, "pose-ros-node", "ros")


if __name__ == "__main__":
    main()
