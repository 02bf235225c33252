"""Stand-ins for robots that run ROS 2: a depth camera, odometry, an inertial unit and tf, thirty
times a second, as seen in the synthetic town, which is shrunk so that it is within reach.
"""

import json
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.simulate.world import RingWorld
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH
from fleetpose.evaluation.system.ros import messages
from fleetpose.evaluation.system.ros.speaking import DIALECTS, Dialect, Node
from fleetpose.protocol.transport import Link, SessionSettings, open_session
from fleetpose.robot_agent.cameras.synthetic import mount

RATE_HZ = 30.0
SCALE = 0.45  # of the town: its walls are 3.4 m away then, and a depth camera sees 6
NAMESPACES = ("/Alpha", "/Bravo", "/Charlie", "/Delta", "/Echo", "/Foxtrot")
BASE, ODOM, OPTICAL = "base_link", "odom", "camera_color_optical_frame"
_EXPOSURES = 7  # in turn: one second of thirty does not end with that with which it began
_DEPTH_SIGMA = 0.002  # m at 1 m; grows with the square
_SEPARATION_DEG = 30.0
_GRAVITY = 9.81


@dataclass(frozen=True)
class Sight:
    """What a standing robot sees and knows.

    Attributes:
        colours: (H, W, 3) uint8 RGB, one for each exposure.
        depths_mm: (H, W) uint16, 0 where there is none.
        K: (3, 3), px.
        T_base_optical: (4, 4).
        T_world_robot: (4, 4), which it does not tell.
    """

    colours: Sequence[npt.NDArray[np.uint8]]
    depths_mm: Sequence[npt.NDArray[np.uint16]]
    K: Floats
    T_base_optical: Floats
    T_world_robot: Floats


def sights(robots: int, seed: int, exposures: int = _EXPOSURES) -> list[Sight]:
    """What so many robots see on a ring in the town."""
    world = RingWorld(robots, _SEPARATION_DEG, seed=seed)
    return [_sight(world, k, exposures, np.random.default_rng((seed, k))) for k in range(robots)]


def _sight(world: RingWorld, k: int, exposures: int, rng: np.random.Generator) -> Sight:
    shots = [world.shoot(k) for _ in range(exposures)]
    T_world_robot, K = shots[0].T_world_robot, world.rig.K_left
    depth = SCALE * world.scene.depth(T_world_robot @ mount(), K, (WIDTH, HEIGHT)).astype(float)
    noisy = [depth + _DEPTH_SIGMA * depth**2 * rng.standard_normal(depth.shape) for _ in shots]
    return Sight(
        [np.ascontiguousarray(shot.left[..., ::-1]) for shot in shots],
        [np.nan_to_num(np.rint(1e3 * one).clip(0, 65535)).astype(np.uint16) for one in noisy],
        K,
        _shrunk(mount()),
        _shrunk(T_world_robot),
    )


def _shrunk(T: Floats) -> Floats:
    small = T.copy()
    small[:3, 3] *= SCALE
    return small


class StandIn:
    """A robot's nodes.

    Args:
        node: publishes its topics.
        namespace: of them.
        sight: what it sees.

    Attributes:
        silent: topics that say nothing for the time being.
    """

    def __init__(self, node: Node, namespace: str, sight: Sight) -> None:
        self.silent: set[str] = set()
        self._node, self._namespace = node, namespace
        height, width = sight.depths_mm[0].shape
        size = width, height
        camera = f"{namespace}/camera"
        colours = [messages.image(one, "rgb8", OPTICAL) for one in sight.colours]
        depths = [messages.image(one, "16UC1", OPTICAL) for one in sight.depths_mm]
        infos = [messages.info(sight.K, size, OPTICAL)]
        up = np.array([0.0, 0.0, _GRAVITY])
        self._steps = [
            self._step(f"{camera}/color/camera_info", infos),
            self._step(f"{camera}/aligned_depth_to_color/camera_info", infos),
            self._step(f"{namespace}/odom", [messages.odometry(np.eye(4), ODOM, BASE)]),
            self._step(f"{namespace}/imu", [messages.imu(up, BASE)]),
            self._step(f"{namespace}/tf", [messages.transforms((ODOM, BASE, np.eye(4)))]),
            self._step(f"{camera}/color/image_raw", colours),
            self._step(f"{camera}/aligned_depth_to_color/image_raw", depths),
        ]
        fixed = messages.transforms((BASE, OPTICAL, sight.T_base_optical))
        self._fixed = node.advertise(f"{namespace}/tf_static", fixed.__msgtype__, latched=True)
        self._fixed(bytes(messages.coded(fixed)))  # kept for whoever comes later

    def publish(self, number: int) -> None:
        """Everything once, with the stamp of now."""
        now_ns = time.time_ns()
        for step in self._steps:
            step(number, now_ns)

    def run(self, stop: threading.Event, rate_hz: float = RATE_HZ) -> None:
        """Publishes until it is stopped."""
        due_s, number = time.monotonic(), 0
        while not stop.wait(max(due_s - time.monotonic(), 0.0)):
            self.publish(number)
            number += 1
            due_s = max(due_s + 1 / rate_hz, time.monotonic() - 1.0)

    def _step(self, topic: str, in_turn: Sequence[object]) -> Callable[[int, int], None]:
        kind: str = in_turn[0].__msgtype__  # pyright: ignore[reportAttributeAccessIssue]
        put, raws = self._node.advertise(topic, kind), [messages.coded(one) for one in in_turn]
        of_tf = kind.endswith("TFMessage")
        at = messages.TRANSFORM_STAMP_AT if of_tf else messages.STAMP_AT

        def step(number: int, stamp_ns: int) -> None:
            if topic in self.silent:
                return
            raw = raws[number % len(raws)]
            messages.stamp(raw, stamp_ns, at)
            put(bytes(raw))

        return step


def main(endpoint: str, dialects: Sequence[Dialect], seed: int) -> None:
    """Runs one robot of each dialect until the process is ended; says the truth, as JSON, once."""
    stop, links, robots = threading.Event(), [], []
    seen = sights(len(dialects), seed)
    for dialect, namespace, sight in zip(dialects, NAMESPACES, seen, strict=False):
        links.append(Link(open_session(SessionSettings(connect=(endpoint,)))))
        robots.append(StandIn(Node(links[-1], dialect), namespace, sight))
    truth = {
        namespace: {"dialect": dialect, "T_world_robot": sight.T_world_robot.tolist()}
        for dialect, namespace, sight in zip(dialects, NAMESPACES, seen, strict=False)
    }
    print(json.dumps(truth), flush=True)
    try:
        threads = [threading.Thread(target=one.run, args=(stop,), daemon=True) for one in robots]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        stop.set()
        for link in links:
            link.close()


if __name__ == "__main__":
    import sys

    main(sys.argv[1], [one for one in DIALECTS if one in sys.argv[2].split(",")], int(sys.argv[3]))
