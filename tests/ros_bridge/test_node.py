"""The bridge as a node of rclpy, of which a stand-in is here: the same messages, byte for byte, as
on zenoh.
"""

import sys
import threading
from functools import partial
from types import ModuleType, SimpleNamespace

import pytest

from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from fleetpose.ros_bridge import bridge as bridging
from fleetpose.ros_bridge import node
from fleetpose.ros_bridge.bridge import Bridge
from fleetpose.ros_bridge.node import RclpyTopics
from fleetpose.ros_bridge.settings import BridgeSettings
from fleetpose.ros_bridge.topics import ODOMETRY, POSE, TF
from fleetpose.rosmsg.dialects import rmw_zenoh
from tests.ros_bridge.test_bridge import Server
from tests.ros_bridge.test_fleet_tree import odometry, pose, told

SETTINGS = BridgeSettings.load(None, {"robot": ["r1=/r1", "r2=/r2"]})


class FakeRos:
    """Of rclpy what a node uses: topics with one subscriber each, and what was published."""

    def __init__(self) -> None:
        self.subscribers: dict[str, object] = {}
        self.coming: list[tuple[str, object]] = []
        self.published: list[tuple[str, bytes]] = []

    def modules(self) -> dict[str, ModuleType]:
        qos = SimpleNamespace(
            DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL="kept", VOLATILE="gone"),
            QoSProfile=lambda depth, durability: durability,
        )
        rclpy = SimpleNamespace(
            ok=lambda: True, create_node=lambda name: self, spin_once=self._spin_once, qos=qos
        )
        made = {"rclpy": rclpy, "rclpy.qos": qos}
        for type in rmw_zenoh.types().types:
            package, kind, name = type.split("/")
            module = made.setdefault(f"{package}.{kind}", SimpleNamespace())
            setattr(module, name, rmw_zenoh.types().types[type])
        return made

    def get_topic_names_and_types(self):
        return [("/r1/odom", [ODOMETRY]), ("/r1/tf_static", [TF]), ("/rosout", ["a/msg/Log"])]

    def create_subscription(self, type, topic, callback, quality):
        assert quality == ("kept" if topic.endswith("static") else "gone")
        self.subscribers[topic] = callback

    def create_publisher(self, type, topic, quality):
        name = type.__msgtype__
        write = partial(rmw_zenoh.types().serialize_cdr, typename=name)
        return SimpleNamespace(
            publish=lambda one: self.published.append((topic, bytes(write(one))))
        )

    def _spin_once(self, ros_node, timeout_sec):
        if self.coming:
            topic, message = self.coming.pop(0)
            self.subscribers[topic](message)


@pytest.fixture
def ros(monkeypatch):
    fake = FakeRos()
    for name, module in fake.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    node._class_of.cache_clear()
    yield fake
    node._class_of.cache_clear()


class Recorded:
    """Topics on which one message waits; keeps what is put as it would be on zenoh."""

    types = staticmethod(rmw_zenoh.types().types.__getitem__)

    def __init__(self, coming, wanted, drops) -> None:
        self.coming, self.published = coming, []

    def take(self, timeout_s):
        return self.coming.pop(0) if self.coming else None

    def put(self, topic, type, message, latched=False):
        self.published.append((topic, bytes(rmw_zenoh.types().serialize_cdr(message, type))))


def test_a_node_says_the_same_as_the_bridge_on_zenoh_byte_for_byte(ros, router, monkeypatch):
    message = odometry("odom", "base_link", pose(2), 10**9)
    recorded = []
    monkeypatch.setattr(bridging, "JOIN_S", 0.0)

    def run_one(topics, server) -> list[tuple[str, bytes]]:
        """A bridge through one odometry message and poses until its robot is joined."""
        link = Link(open_session(SessionSettings(connect=(router,))))
        stop = threading.Event()
        bridge = Bridge(SETTINGS, link, topics)
        thread = threading.Thread(target=bridge.run, args=(stop,), daemon=True)
        thread.start()
        published = recorded[-1].published if recorded else ros.published

        def joined() -> bool:
            server.tell(told("r1", pose(3), 10**9))
            return any(topic == "/tf" for topic, _ in published)

        try:
            assert wait_until(joined, 30.0, 0.1)
        finally:
            stop.set()
            thread.join()
            link.close()
        return published

    def on_zenoh(wanted, drops):
        recorded.append(Recorded([bridging.Message("/r1/odom", ODOMETRY, message)], wanted, drops))
        return recorded[-1]

    link = Link(open_session(SessionSettings(connect=(router,))))
    try:
        ros.coming.append(("/r1/odom", message))
        by_node = run_one(RclpyTopics, Server(link))
        by_zenoh = run_one(on_zenoh, Server(link))
    finally:
        link.close()
    assert set(ros.subscribers) == {"/r1/odom", "/r1/tf_static"}, "and nothing else"
    for topic in ("/fleet/r1/pose", "/fleet/r1/odometry", "/tf"):
        first = [next(raw for name, raw in said if name == topic) for said in (by_node, by_zenoh)]
        assert first[0] == first[1], topic
    assert rmw_zenoh.types().deserialize_cdr(by_node[0][1], POSE).header.frame_id == "fleet"


def test_without_ros_the_node_says_what_to_do(monkeypatch):
    monkeypatch.setattr(node, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match=r"setup\.bash"):
        node.main()
