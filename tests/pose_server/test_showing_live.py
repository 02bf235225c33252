"""A running site in Foxglove: who connects sees it as it is, and only then are images asked for."""

import json
import struct
import threading
from contextlib import ExitStack

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from websockets.sync.client import connect

from fleetpose.pose_server.recording.live import show_site
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import CameraAnnouncement, ImageHeader, View
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from tests.pose_server.scene import pair_of_views, turned
from tests.protocol.message_examples import EXAMPLES, POSE

pytest.importorskip("foxglove")
KEYS = Keys("demo")
JPEG = b"\xff\xd8 an image"


class Viewer:
    """What Foxglove would be told: its websocket protocol, version 1. Use it in a `with`."""

    def __init__(self, address: str) -> None:
        self.connection = connect(address, subprotocols=["foxglove.sdk.v1"], open_timeout=10)
        self.channels: dict[str, int] = {}
        self.got: dict[int, bytes] = {}

    def __enter__(self):
        self.socket = self.connection.__enter__()
        return self

    def __exit__(self, *ended):
        self.connection.__exit__(*ended)

    def hear(self) -> None:
        """One message."""
        message = self.socket.recv(timeout=20)
        if isinstance(message, bytes):
            if message[0] == 1:
                self.got[struct.unpack_from("<I", message, 1)[0]] = message[13:]
        elif (said := json.loads(message))["op"] == "advertise":
            self.channels |= {one["topic"]: one["id"] for one in said["channels"]}

    def channel(self, topic: str) -> int:
        while topic not in self.channels:
            self.hear()
        return self.channels[topic]

    def subscribe(self, topic: str) -> int:
        channel = self.channel(topic)
        wanted = [{"id": channel, "channelId": channel}]
        self.socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        return channel

    def message(self, subscription: int) -> bytes:
        while subscription not in self.got:
            self.hear()
        return self.got[subscription]


def test_who_connects_late_sees_the_site_and_robots_send_images_only_to_who_looks(router):
    view = pair_of_views(np.random.default_rng(1), turned(15))[0]
    T = np.eye(4)
    T[0, 3] = 2.0
    of_robot = {"robot": "r1", "view": view.name, "T_fleet_robot": T, "located": True}
    pose = POSE.model_copy(update=of_robot)
    camera = EXAMPLES[CameraAnnouncement].model_copy(update={"robot": "r1"})
    robot, here = (
        Link(open_session(SessionSettings(connect=(router,), timeout_s=5.0))) for _ in range(2)
    )
    stop, addresses, closing = threading.Event(), [], ExitStack()
    arguments = (here, KEYS, "127.0.0.1", 0, stop, addresses.append)
    showing = threading.Thread(target=show_site, args=arguments)
    try:
        clouds, images = robot.bulk(KEYS.cloud("r1")), robot.bulk(KEYS.image("r1"))
        announced, poses = robot.latched(KEYS.camera("r1")), robot.latched(KEYS.pose("r1"))
        announced.put(pack(camera), encoding_of(CameraAnnouncement))
        showing.start()
        assert wait_until(lambda: bool(addresses) and clouds.wanted, 20)
        clouds.put(pack(view), encoding_of(View))
        poses.put(pack(pose), encoding_of(type(pose)))
        viewer = closing.enter_context(Viewer(addresses[0]))
        viewer.channel("/tf")  # all of it was said by now, to nobody
        assert not images.wanted
        [body, eye] = FrameTransforms.FromString(viewer.message(viewer.subscribe("/tf"))).transforms
        assert (body.child_frame_id, body.translation.x) == ("r1", 2.0)
        assert eye.parent_frame_id == "r1"
        pictures = viewer.subscribe("/robot/r1/image")
        assert wait_until(lambda: images.wanted, 20)
        header = pack(ImageHeader(view=view.name, stamp_ns=view.stamp_ns, scale=2))
        images.put(JPEG, "image/jpeg", header)
        assert JPEG in viewer.message(pictures)
        closing.close()
        assert wait_until(lambda: not images.wanted, 20)
    finally:
        closing.close()
        stop.set()
        if showing.ident is not None:
            showing.join(20)
        robot.close()
        here.close()
