"""The bridge between a site's router and ROS 2 nodes' topics on zenoh, seen by a stand-in for RViz
that is as strict as rmw_zenoh: it drops what has another hash or no attachment.
"""

import struct
import threading
from contextlib import ExitStack, contextmanager
from functools import partial

import numpy as np
import pytest

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RobotPose
from fleetpose.protocol.settings import SettingsRefusedError
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from fleetpose.ros_bridge.bridge import Bridge
from fleetpose.ros_bridge.settings import BridgeSettings
from fleetpose.ros_bridge.topics import ODOMETRY, POSE, TF
from fleetpose.ros_bridge.zenoh_topics import Writer, ZenohTopics
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.dialects.rmw_zenoh import NO_HASH, endpoint_of, publisher_token
from fleetpose.rosmsg.transforms import Tf, inverse
from tests.ros_bridge.test_fleet_tree import odometry, pose, told, transforms

KEYS = Keys("demo")
WITHIN_S = 20.0


class Viewer:
    """What subscribes in ROS 2: only what rmw_zenoh would hand on."""

    def __init__(self, link: Link, hash_of=rmw_zenoh.type_hash) -> None:
        self.got: dict[str, list] = {}
        self.dropped = 0
        for type in (TF, POSE, ODOMETRY):
            key = rmw_zenoh.topic_key(0, "**", type, hash_of(type))
            link.on_latched(key, lambda sample, type=type: self._store(sample, type))

    def _store(self, sample, type) -> None:
        if len(sample.attachment or b"") != 33 or sample.attachment[16] != 16:
            self.dropped += 1
            return
        topic = "/" + sample.key.split("/", 1)[1].rsplit("/", 2)[0]
        message = rmw_zenoh.types().deserialize_cdr(sample.payload, type)
        self.got.setdefault(topic, []).append(message)

    def tf(self) -> Tf:
        """As tf2 has it; two parents of one frame are an error."""
        tf, parents = Tf(), {}
        for topic in ("/tf", "/tf_static"):
            for message in self.got.get(topic, []):
                for one in message.transforms:
                    parent = parents.setdefault(one.child_frame_id, one.header.frame_id)
                    assert parent == one.header.frame_id, one.child_frame_id
                tf.add(message, static=topic == "/tf_static")
        return tf


@contextmanager
def bridging(router, **given):
    """A bridge, and links for the server, the robots' nodes and the viewer."""
    settings = BridgeSettings.load(None, {"robot": ["r1=/r1", "r2=/r2"], **given})
    stop = threading.Event()
    with ExitStack() as opened:
        links = [Link(open_session(SessionSettings(connect=(router,)))) for _ in range(4)]
        for link in links:
            opened.callback(link.close)
        bridge = Bridge(settings, links[0], partial(ZenohTopics, links[0], 0))
        thread = threading.Thread(target=bridge.run, args=(stop,), daemon=True)
        thread.start()
        opened.callback(thread.join)
        opened.callback(stop.set)
        yield links[1:]


class Server:
    def __init__(self, link: Link) -> None:
        self._publishers = {name: link.latched(KEYS.pose(name)) for name in ("r1", "r2")}

    def tell(self, message: RobotPose) -> None:
        self._publishers[message.robot].put(pack(message), encoding_of(RobotPose))


def test_a_viewer_gets_one_tree_in_which_robots_stand_as_the_fleet_says(router):
    with bridging(router) as (server_link, nodes, viewer_link):
        server, viewer, robots = Server(server_link), Viewer(viewer_link), Writer(nodes, 0)
        at = {"r1": pose(1, 2, 0.3), "r2": pose(-2, 0, 1.2)}
        lens = transforms(("base_link", "lens", pose(0.1), 0))
        drive = transforms(("odom", "base_link", pose(5, 1, 0.5), 10**9))

        def moves() -> bool:
            robots.put("/r1/tf_static", TF, lens, latched=True)
            robots.put("/r1/tf", TF, drive)
            robots.put("/r2/odom", ODOMETRY, odometry("odom", "base_link", pose(7), 10**9))
            for name, T in at.items():
                server.tell(told(name, T, 10**9))
            tf = viewer.tf()
            return all(tf.chain("fleet", f"{name}/base_link") for name in at) and (
                tf.parents.get("r1/lens") == "r1/base_link"
                and {"/fleet/r1/pose", "/fleet/r2/odometry"} <= viewer.got.keys()
            )

        assert wait_until(moves, WITHIN_S, 0.1), viewer.got.keys()
        tf = viewer.tf()
        relative = tf.lookup("r1/base_link", "r2/base_link")
        assert np.abs(relative - inverse(at["r1"]) @ at["r2"]).max() < 1e-9
        assert tf.parents["r1/odom"] == tf.parents["r2/odom"] == "fleet"
        posed = viewer.got["/fleet/r1/pose"][0]
        assert posed.header.frame_id == "fleet" and posed.pose.pose.position.y == 2.0
        driven = viewer.got["/fleet/r2/odometry"][0]
        assert driven.child_frame_id == "r2/base_link" and driven.twist.covariance[0] == -1
        assert viewer.dropped == 0 and "/r1/tf" in viewer.got, "the robot's own stays its own"


def test_nothing_is_told_of_robots_that_are_not_located(router):
    with bridging(router) as (server_link, nodes, viewer_link):
        server, viewer, robots = Server(server_link), Viewer(viewer_link), Writer(nodes, 0)
        drive = transforms(("odom", "base_link", pose(5), 10**9))

        def second_joins() -> bool:
            robots.put("/r1/tf", TF, drive)
            server.tell(told("r1", pose(), 10**9, located=False))
            server.tell(told("r2", pose(), 10**9))
            return "/tf" in viewer.got and "/fleet/r2/pose" in viewer.got

        assert wait_until(second_joins, WITHIN_S, 0.1)
        assert "/fleet/r1/pose" not in viewer.got
        assert set(viewer.tf().parents) == {"r2/base_link"}


def test_map_odom_goes_to_the_robots_own_tf_and_only_where_asked_for(router):
    with bridging(router, map_odom=["r1"]) as (server_link, nodes, viewer_link):
        server, viewer, robots = Server(server_link), Viewer(viewer_link), Writer(nodes, 0)

        def mapped() -> bool:
            for name in ("r1", "r2"):
                robots.put(f"/{name}/odom", ODOMETRY, odometry("odom", "base_link", pose(2), 10**9))
                server.tell(told(name, pose(3), 10**9))
            said = viewer.got.get("/r1/tf", [])  # which the bridge hears as well
            return len(said) > 5 and "/fleet/r2/pose" in viewer.got

        assert wait_until(mapped, WITHIN_S, 0.1)
        assert viewer.tf().parents["r1/odom"] == "fleet"
        (joint,) = viewer.got["/r1/tf"][0].transforms
        assert (joint.header.frame_id, joint.child_frame_id) == ("map", "odom")
        assert joint.transform.translation.x == 1.0
        assert "/r2/tf" not in viewer.got


def test_nodes_of_humble_get_what_has_no_hash(router):
    with bridging(router) as (server_link, _, viewer_link):
        server, viewer = Server(server_link), Viewer(viewer_link, lambda type: NO_HASH)
        token = publisher_token(0, "abc", 1, "/fleet/r1/pose", POSE, NO_HASH, False, 10)
        viewer_link.token(token.replace("/MP/", "/MS/"))

        def got() -> bool:
            server.tell(told("r1", pose(), 10**9))
            return "/fleet/r1/pose" in viewer.got

        assert wait_until(got, WITHIN_S, 0.1)


def test_damaged_messages_of_nodes_and_servers_end_nothing(router):
    with bridging(router) as (server_link, nodes, viewer_link):
        server, viewer, robots = Server(server_link), Viewer(viewer_link), Writer(nodes, 0)
        rng = np.random.default_rng(0)

        def still_works() -> bool:
            robots.put("/r1/odom", ODOMETRY, odometry("odom", "base_link", pose(2), 10**9))
            key = rmw_zenoh.topic_key(0, "/r1/odom", ODOMETRY, rmw_zenoh.type_hash(ODOMETRY))
            for _ in range(20):
                junk = rng.bytes(int(rng.integers(0, 900)))
                nodes.session.put(key, junk)
                server_link.session.put(KEYS.pose("r1"), junk)
                nodes.session.put(f"@ros2_lv/0/{rng.bytes(4).hex()}", junk)
            server.tell(told("r1", pose(3), 10**9))
            return viewer.tf().chain("fleet", "r1/base_link") is not None

        assert wait_until(still_works, WITHIN_S, 0.1)


@pytest.mark.parametrize(
    "token",
    [
        "@ros2_lv/0/z/0/3/MP/%/%r1/node/%r1%odom/nav_msgs::msg::dds_::Odometry_/RIHS01_x/:1:,5:,:,:,,",
        "@/z/@ros2_lv/MP/r1§odom/nav_msgs§msg§Odometry/:::",
    ],
)
def test_tokens_of_both_dialects_are_read(token):
    endpoint = endpoint_of(token)
    assert endpoint is not None
    assert (endpoint.topic, endpoint.type) == ("/r1/odom", ODOMETRY)
    assert endpoint.latched == (token[1] == "r")
    assert endpoint.key in ("0/r1/odom/nav_msgs::msg::dds_::Odometry_/*", "r1/odom")


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@",
        "@ros2_lv",
        "@ros2_lv/" + "x/" * 11 + "y",
        "@/z/@ros2_lv/SS/a/b/c",
        "@/z/@ros2_lv/MP",
    ],
)
def test_other_tokens_are_nobodys(token):
    assert endpoint_of(token) is None


def test_an_attachment_carries_number_time_and_its_publisher():
    sequence, stamp_ns, size, *_ = struct.unpack("<qqBQQ", rmw_zenoh.attachment(7, 9, "token"))
    assert (sequence, stamp_ns, size) == (7, 9, 16)
    assert rmw_zenoh.attachment(7, 9, "a")[17:] != rmw_zenoh.attachment(7, 9, "b")[17:]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"robot": []}, "no robot is named"),
        ({"robot": ["r1=r1"]}, "write NAME=/NAMESPACE"),
        ({"robot": ["r1", "r1"]}, "named twice"),
        ({"robot": ["r1=/a", "r2=/a"]}, "named twice"),
        ({"robot": ["r1"], "map_odom": ["r2"]}, "r2 is no --robot"),
        ({"robot": ["r1"], "tf": "tf"}, "no topic"),
        ({"robot": ["r1=/fleet/r1"]}, "the fleet's own topics"),
    ],
)
def test_settings_that_cannot_be_are_refused(given, said):
    with pytest.raises(SettingsRefusedError, match=said):
        BridgeSettings.load(None, given)
