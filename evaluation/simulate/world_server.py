"""The synthetic world as a process of its own: it alone knows the truth; robots get a rig and
images.

Protocol, on loopback: a robot sends one line of JSON, `{"robot": "r3"}`, and gets its rig as one
line; then for each line `"next"` a header line (stamp_ns, width, height, left_bytes, right_bytes)
and both raw BGR images. A request that cannot be met gets a line `{"error": ...}`. As `r3@200` a
robot sees what it saw 200 ms before the newest image that it got as `r3`.
"""

import json
import signal
import socketserver
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.options.fleets import WorldOptions
from fleetpose.evaluation.simulate.world import PlanWorld, RingWorld, World
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig

MAX_LINE = 4096


class WorldServer(socketserver.ThreadingTCPServer):
    """Serves a world's robots, one thread per connection; logs every true pose if there is a
    file for it.
    """

    allow_reuse_address = True
    daemon_threads = True

    def __init__(self, address: tuple[str, int], world: World, log: Path | None) -> None:
        self.world = world
        self._began_s = time.monotonic()
        self._log = log
        self._guard = threading.Lock()
        self._newest: dict[str, tuple[int, float]] = {}
        super().__init__(address, _Robot)

    def shoot(self, robot: str) -> tuple[dict[str, int], bytes, bytes]:
        """Header and both images of now."""
        robot, _, before_ms = robot.partition("@")
        if before_ms:
            stamp_ns, t_s = self._newest.get(robot, (time.time_ns(), 0.0))
            shot = self.world.shoot(robot, t_s - 1e-3 * float(before_ms))
        else:
            stamp_ns, t_s = time.time_ns(), time.monotonic() - self._began_s
            self._newest[robot] = stamp_ns, t_s
            shot = self.world.shoot(robot, t_s)
            self._note(robot, stamp_ns, shot.T_world_robot)
        left, right = shot.left.tobytes(), shot.right.tobytes()
        height, width = shot.left.shape[:2]
        sizes = {"left_bytes": len(left), "right_bytes": len(right)}
        return {"stamp_ns": stamp_ns, "width": width, "height": height, **sizes}, left, right

    def _note(self, robot: str, stamp_ns: int, T_world_robot: np.ndarray) -> None:
        if self._log is None:
            return
        entry = {"robot": robot, "stamp_ns": stamp_ns, "T_world_robot": T_world_robot.tolist()}
        with self._guard, self._log.open("a") as log:
            log.write(json.dumps(entry) + "\n")


class _Robot(socketserver.StreamRequestHandler):
    """One robot's connection."""

    server: WorldServer  # pyright: ignore[reportIncompatibleVariableOverride]

    def handle(self) -> None:
        try:
            robot = self._introduced()
            if robot is None:
                return
            self._say(rig_message(self.server.world.rig))
            while request := self.rfile.readline(MAX_LINE):
                if _json(request) != "next":
                    self._say({"error": 'the only request is "next"'})
                    continue
                header, left, right = self.server.shoot(robot)
                self._say(header)
                self.wfile.write(left)
                self.wfile.write(right)
        except (ConnectionError, TimeoutError):
            return  # the robot has left

    def _introduced(self) -> str | None:
        request = _json(self.rfile.readline(MAX_LINE))
        name = request.get("robot") if isinstance(request, dict) else None
        place, _, before_ms = str(name).partition("@")
        try:
            self.server.world.robot_index(place)
            if before_ms and not before_ms.isdigit():
                raise FleetPoseError(f"'{name}': write r3@200 for what r3 saw 200 ms before")
        except FleetPoseError as error:
            self._say({"error": str(error)})
            return None
        return str(name)

    def _say(self, message: dict[str, Any]) -> None:
        self.wfile.write(json.dumps(message).encode() + b"\n")


def rig_message(rig: StereoRig) -> dict[str, Any]:
    """What a robot is told of its cameras: no pose."""
    return {
        "K_left": rig.K_left.tolist(),
        "D_left": rig.D_left.tolist(),
        "K_right": rig.K_right.tolist(),
        "D_right": rig.D_right.tolist(),
        "R": rig.T_right_left[:3, :3].tolist(),
        "t": rig.T_right_left[:3, 3].tolist(),
        "width": rig.size[0],
        "height": rig.size[1],
    }


def write_truth(world: World, file: Path) -> None:
    """Writes radius and first poses in one step, so that a reader never sees half a file."""
    robots = {name: world.T_world_robot(name).tolist() for name in world.names}
    part = file.with_suffix(".part")
    part.write_text(json.dumps({"radius_m": world.radius_m, "T_world_robots": robots}))
    part.replace(file)


def world_of(options: WorldOptions) -> World:
    """The world that is asked for and its robots.

    Raises:
        FleetPoseError: it cannot be.
    """
    if options.plan is None:
        if options.unique:
            raise FleetPoseError(f"--unique {options.unique}: name a plan with --plan")
        return RingWorld(
            options.robots,
            options.separation_deg,
            seed=options.seed,
            moving=options.moving,
            turning=options.turning,
            person=options.person,
        )
    if options.moves or options.person or options.separation_deg is not None:
        raise FleetPoseError(
            f"in the plan {options.plan} robots stand still, here and there, and nobody walks"
        )
    return PlanWorld(options.plan, options.robots, options.unique, options.seed)


def main(options: WorldOptions, listen: str, truth_file: Path | None) -> None:
    """Serves a world until SIGTERM or SIGINT.

    Args:
        options: which.
        listen: `host:port`.
        truth_file: where the true poses go; of a moving world those of every frame as well, one
            JSON line each, in a file of that name with `.log.jsonl` behind it.

    Raises:
        FleetPoseError: the address is taken or no address, or the world cannot be.
    """
    host, _, port = listen.rpartition(":")
    if not host or not port.isdigit():
        raise FleetPoseError(f"'{listen}' is no address: give host:port")
    world = world_of(options)
    logged = truth_file is not None and options.moves
    log = Path(f"{truth_file}.log.jsonl") if logged else None
    try:
        server = WorldServer((host, int(port)), world, log)
    except OSError as error:
        raise FleetPoseError(f"cannot listen on {listen}: {error.strerror}") from error
    if truth_file is not None:
        write_truth(world, truth_file)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: threading.Thread(target=server.shutdown).start())
    with server:
        print(f"world of {options.robots} robots on {listen}", flush=True)
        server.serve_forever(poll_interval=0.1)


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None
