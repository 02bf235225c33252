"""Damaged pieces of ROS, and what reads them: messages, first messages, tokens, bags."""

import random
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rosbags.rosbag1 import Writer as Rosbag1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2
from rosbags.typesys import Stores, get_typestore

from fleetpose.evaluation.system.fuzz.ros_messages import STAMP_NS, Robot, damaged, robots
from fleetpose.protocol.codec import pack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import Odometry
from fleetpose.robot_agent.cameras.bag.camera import open_camera
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.ros.network import recorded
from fleetpose.robot_agent.cameras.topics.options import TopicOptions
from fleetpose.robot_agent.cameras.topics.sensor import Sensor
from fleetpose.robot_agent.features.packing import cloud_of
from fleetpose.rosmsg.bag import Recorded, Topic
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.live.directory import Directory
from fleetpose.rosmsg.stamps import header_ns
from fleetpose.rosmsg.typestore import Types

Pieces = Iterator[tuple[str, Callable[[], object]]]

_ANEW = 60  # pieces, then another sensor: what was taken in changes it
_MOMENTS, _PERIOD_NS = 3, 100_000_000
_SIGNS = "/%*$#?@§:_~ \n\x00é☃" + 3 * "ab1"


class _Memory:
    """A robot's messages as a `TopicSource`."""

    name, what = "the robot", "the robot"

    def __init__(self, robot: Robot, types: Types, damage: dict[str, bytes] | None = None) -> None:
        self._types, self._robot = types, robot
        self._raw = robot.raw | (damage or {})
        self.topics: Sequence[Topic] = robot.topics

    def first(self, topic: str) -> Any | None:
        try:
            return self.read(topic, self._raw[topic])
        except CodecError:
            return None  # as a bag and a network do

    def transforms(self, topic: str) -> Iterator[Any]:
        if (read := self.first(topic)) is not None:
            yield read

    def read(self, topic: str, raw: bytes) -> Any:
        message = self.recorded(topic, raw)
        return self._types.read(message.kind, message.raw)

    def recorded(self, topic: str, raw: bytes) -> Recorded:
        return recorded(topic, self._robot.types[topic], raw)


def in_messages(chance: random.Random) -> Pieces:
    """Of a sensor that runs: images and ranges, and the small topics beside them."""
    types, known = Types(), robots()
    while True:
        form = chance.choice(list(known))
        robot = known[form]
        source = _Memory(robot, types)
        sensor = Sensor(source, TopicOptions())
        for _ in range(_ANEW):
            topics = [*sensor.streams, *sensor.followed, *sensor.sampled]
            topic = chance.choice(topics)
            what, raw = damaged(chance, robot.raw[topic])
            yield f"{form}, {what}", partial(_use, source, sensor, robot, topic, raw)


def _use(source: _Memory, sensor: Sensor, robot: Robot, topic: str, raw: bytes) -> None:
    if topic not in sensor.streams:
        sensor.note(topic, source.read(topic, raw))
        raw = robot.raw[topic := sensor.streams[0]]  # and a frame with what was noted
    stamp_ns = header_ns(source.recorded(topic, raw))
    of_both = robot.raw | {topic: raw}
    image, ranges = (source.read(one, of_both[one]) for one in sensor.streams)
    _sent(sensor.frame(image, ranges, stamp_ns))


def _sent(frame: Frame) -> None:
    """What an agent makes of a frame, without its keypoints."""
    cloud_of(frame.ranges, frame.model)
    if (odometry := frame.odometry) is not None and odometry.covariance is not None:
        pose = {"T_odom_robot": odometry.T_odom_robot, "covariance": odometry.covariance}
        pack(Odometry(robot="r1", epoch=new_epoch(), stamp_ns=frame.stamp_ns, **pose))
    up = frame.up_camera
    if up is not None and not abs(np.linalg.norm(up) - 1) < 1e-6:
        raise ValueError(f"up is {up.tolist()}")


def at_the_start(chance: random.Random) -> Pieces:
    """The first message of a topic, by which a camera is put together."""
    types, known = Types(), robots()
    while True:
        form = chance.choice(list(known))
        robot = known[form]
        topic = chance.choice(list(robot.raw))
        what, raw = damaged(chance, robot.raw[topic])
        source = _Memory(robot, types, {topic: raw})
        yield f"{form}, {what}", partial(Sensor, source, TopicOptions())


def in_tokens(chance: random.Random) -> Pieces:
    """What stands under `@ros2_lv`: what is believed of it must be a key that can be asked for."""
    image = "sensor_msgs/msg/Image"
    good = (
        rmw_zenoh.publisher_token(0, "ab12", 1, "/r1/image", image, rmw_zenoh.NO_HASH, False, 5),
        rmw_zenoh.publisher_token(3, "ab12", 2, "/tf_static", image, "RIHS01_ab", True, 5),
        "@/ab12/@ros2_lv/MP/r1§image/sensor_msgs§msg§Image/:::",
    )
    directory = Directory(most=50)
    while True:
        token = _spoilt(chance, chance.choice(good))

        def use(token: str = token) -> None:
            directory.note(token, True)
            for endpoint in directory.endpoints().values():
                zenoh.KeyExpr(endpoint.key)
            directory.note(token, chance.random() < 0.1)

        yield "token", use


def _spoilt(chance: random.Random, token: str) -> str:
    deed = chance.randrange(4)
    if deed == 0:
        return "".join(chance.choices(_SIGNS, k=chance.choice((0, 1, 30, 3000))))
    if deed == 1:
        return token[: chance.randrange(len(token))]
    if deed == 2:
        chunks = token.split("/")
        chunks[chance.randrange(len(chunks))] = "".join(
            chance.choices(_SIGNS, k=chance.randrange(9))
        )
        return "/".join(chunks)
    signs = list(token)
    for _ in range(chance.randint(1, 4)):
        signs[chance.randrange(len(signs))] = chance.choice(_SIGNS)
    return "".join(signs)


def in_bags(chance: random.Random, folder: Path) -> Pieces:
    """Files that are cut off or spoilt, played to their end."""
    good = [file.read_bytes() for file in _bags(folder)]
    suffixes = [file.suffix for file in _bags(folder)]
    while True:
        k = chance.randrange(len(good))
        what, raw = damaged(chance, good[k])
        if chance.random() < 0.3:
            raw = good[k][: chance.randrange(len(good[k]))]
        path = folder / f"damaged{suffixes[k]}"
        path.write_bytes(raw)
        yield f"{suffixes[k]}, {what}", partial(_play, path)


def _play(path: Path) -> None:
    camera = open_camera(str(path), "once", bag=BagOptions(speed=None))
    try:
        for _ in camera.frames():
            pass
    finally:
        camera.close()


def _bags(folder: Path) -> list[Path]:
    """A good one of each kind, written once."""
    robot, made = robots()["raw"], []
    for plugin in (StoragePlugin.MCAP, StoragePlugin.SQLITE3):
        path = folder / f"good_{plugin.name.lower()}"
        if not path.exists():
            _write2(path, robot, plugin)
        made += [file for file in sorted(path.iterdir()) if file.suffix in (".mcap", ".db3")]
    path = folder / "good.bag"
    if not path.exists():
        _write1(path, robot)
    return [*made, path]


def _write2(path: Path, robot: Robot, plugin: StoragePlugin) -> None:
    with Rosbag2(path, version=9, storage_plugin=plugin) as writer:
        for topic, type in robot.types.items():
            connection = writer.add_connection(topic, type, typestore=rmw_zenoh.types())
            for k in range(_MOMENTS):
                writer.write(connection, STAMP_NS + k * _PERIOD_NS, robot.raw[topic])


def _write1(path: Path, robot: Robot) -> None:
    """ROS 1 writes images and infos alike but for the header's number: the images will do."""
    store, types = get_typestore(Stores.ROS1_NOETIC), rmw_zenoh.types()
    with Rosbag1(path) as writer:
        for topic in ("/c/image_raw", "/depth/image_raw"):
            kind = robot.types[topic]
            image: Any = types.deserialize_cdr(robot.raw[topic], kind)
            head = image.header
            image.header = store.types["std_msgs/msg/Header"](0, head.stamp, head.frame_id)
            connection = writer.add_connection(topic, kind, typestore=store)
            raw = bytes(store.serialize_ros1(image, kind))
            for k in range(_MOMENTS):
                writer.write(connection, STAMP_NS + k * _PERIOD_NS, raw)
