"""Damaged messages and attachments over a router, to an agent's subscriptions of a robot that runs
beside them.
"""

import random
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Self

import numpy as np
import zenoh

from fleetpose.evaluation.system.fuzz.ros_messages import SIZE, Robot, damaged, robots
from fleetpose.evaluation.system.fuzz.ros_pieces import Pieces
from fleetpose.evaluation.system.ros.speaking import Node
from fleetpose.evaluation.system.ros.stand_in import Sight, StandIn
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.transport import Link, SessionSettings, free_port, open_session
from fleetpose.robot_agent.cameras.ros.camera import RosCamera, open_camera
from fleetpose.robot_agent.cameras.ros.network import MAX_BYTES, Arrivals, RosNetwork
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.dialects.rmw_zenoh import Endpoint

_DOMAIN = 7
_WITHIN_S = 5.0
_FRAMES = 3
_LARGE_EVERY = 200


class Wire:
    """A router, a robot that runs, an agent's camera of it, and a sender of damaged messages.

    Args:
        camera: of the robot.
        network: of a robot whose messages are damaged.
        sender: who sends them.
    """

    def __init__(self, camera: RosCamera, network: RosNetwork, sender: Link) -> None:
        self._camera, self._network, self._sender = camera, network, sender

    @classmethod
    @contextmanager
    def opened(cls) -> Iterator[Self]:
        """Everything, on this machine."""
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        with ExitStack() as closing:

            def link(settings: SessionSettings) -> Link:
                opened = Link(open_session(settings))
                closing.callback(opened.close)
                return opened

            client = SessionSettings(connect=(endpoint,))
            link(SessionSettings(listen=(endpoint,)))
            stop = threading.Event()
            stand_in = StandIn(Node(link(client), "jazzy"), "/r1", _sight())
            thread = threading.Thread(target=stand_in.run, args=(stop,), daemon=True)
            thread.start()
            closing.callback(thread.join)
            closing.callback(stop.set)
            camera = open_camera(endpoint, "once", ros=RosOptions(namespace="/r1"))
            closing.callback(camera.close)
            network = RosNetwork(link(client), _DOMAIN)
            yield cls(camera, network, link(client))

    def pieces(self, chance: random.Random) -> Pieces:
        """Damaged messages, one after the other, with whatever attachment."""
        known, number = robots(), 0
        arrivals = Arrivals(self._network.drops)
        with ExitStack() as leaving:
            endpoints = {}
            for form, robot in known.items():
                for topic, type in robot.types.items():
                    name = f"/{form}{topic}"
                    key = rmw_zenoh.topic_key(_DOMAIN, name, type)
                    endpoints[form, topic] = endpoint = Endpoint(name, type, key, "publisher")
                    leaving.callback(self._network.subscribe(endpoint, arrivals.store))
            while True:
                number += 1
                form = chance.choice(list(known))
                topic = chance.choice(list(known[form].raw))
                what, raw = damaged(chance, known[form].raw[topic])
                if number % _LARGE_EVERY == 0:
                    what, topic, raw = "oversize", "/odom", bytes(MAX_BYTES + 1)
                endpoint, carried = endpoints[form, topic], _attachment(chance)
                yield what, partial(self._send, endpoint, raw, carried, arrivals)

    def frames(self) -> int:
        """How many of a few frames the robot beside them gives."""
        return sum(1 for _, _ in zip(range(_FRAMES), self._camera.frames(), strict=False))

    def _send(self, to: Endpoint, raw: bytes, carried: bytes | None, arrivals: Arrivals) -> None:
        """Raises:
        CodecError: it was counted among the drops.
        RuntimeError: it neither came nor was counted.
        """
        before = sum(self._network.drops.snapshot().values())
        block = zenoh.CongestionControl.BLOCK
        key = to.key.removesuffix("*") + "RIHS01_00"
        self._sender.session.put(key, raw, attachment=carried, congestion_control=block)
        for _ in range(int(_WITHIN_S / 0.05)):
            message = arrivals.take(0.05)
            if message is not None:
                self._network.read(message)
            if sum(self._network.drops.snapshot().values()) > before:
                raise CodecError("counted")
            if message is not None:
                return
        raise RuntimeError("a message was lost")


def _attachment(chance: random.Random) -> bytes | None:
    good = rmw_zenoh.attachment(chance.randrange(2**40), 0, "token")
    choices: tuple[Callable[[], bytes | None], ...] = (
        lambda: None,
        lambda: good,
        lambda: b"",
        lambda: good[: chance.randrange(33)],
        lambda: chance.randbytes(chance.choice((1, 33, 5000))),
    )
    return chance.choice(choices)()


def _sight() -> Sight:
    robot: Robot = robots()["raw"]
    image, depth, info = (
        _read(robot, topic) for topic in ("/c/image_raw", "/depth/image_raw", "/c/camera_info")
    )
    width, height = SIZE
    return Sight(
        [np.array(image.data).reshape(height, width, 3)],
        [np.array(depth.data).view(np.uint16).reshape(height, width)],
        info.k.reshape(3, 3),
        np.eye(4),
        np.eye(4),
    )


def _read(robot: Robot, topic: str) -> Any:
    return rmw_zenoh.types().deserialize_cdr(robot.raw[topic], robot.types[topic])
