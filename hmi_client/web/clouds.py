"""Points of all robots for the view in 3D: asked for only while somebody looks, and again only of
robots that have gone on.
"""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.web.frames import points_of_cloud
from fleetpose.protocol.clouds import some_points_of
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import RobotPose, View, ViewName

log = logging.getLogger(__name__)
Floats = npt.NDArray[np.floating]

POINTS = 3000
_STAYED_M, _STAYED_RAD = 0.2, np.radians(5.0)  # nearer than that it is the same place
_MOVED_M, _MOVED_RAD = 0.005, np.radians(0.1)  # a pose that changed less is not told again
_RETRY_S, _SELDOM_S = 2.0, 60.0  # who gives none is asked again after twice as long each time
_PAUSE_S = 0.02
_NO_POINTS = points_of_cloud(np.zeros((0, 3)), np.zeros((0, 3), np.uint8))
_HEIGHTS = (-0.1, 0.0, 0.15, 0.4)  # shares of the scene's depth
_COLOURS = np.array([(60, 90, 170), (90, 160, 190), (190, 190, 150), (190, 120, 60)], float)


@dataclass(frozen=True)
class Cloud:
    """The points of one place of a robot.

    Attributes:
        keyframe: grows with every place.
        version: grows with every pose.
        T_fleet_robot: (4, 4) where they are.
        points: packed, as pages get them.
    """

    keyframe: int
    version: int
    T_fleet_robot: Floats
    points: bytes

    @property
    def pose_alone(self) -> bytes:
        """What stands in place of the points for who has them."""
        return _NO_POINTS


class Clouds:
    """Follows the robots in a thread while it is wanted.

    Args:
        session: what is followed.
        fetch: asks for a view without its image.
        changed: called when there is something new.
    """

    def __init__(
        self,
        session: OperatorSession,
        fetch: Callable[[ViewName], View],
        changed: Callable[[], None],
    ) -> None:
        self._session, self._fetch, self._changed = session, fetch, changed
        self.known: dict[str, Cloud] = {}
        self._next_s: dict[str, float] = {}
        self._pause_s: dict[str, float] = {}
        self._stop, self._wanted = threading.Event(), threading.Event()
        self._version = self._seen = 0
        self._wanted.set()
        self._thread = threading.Thread(name="web clouds", target=self._run, daemon=True)
        self._thread.start()

    def pause(self, paused: bool) -> None:
        """Asks nobody while nobody looks."""
        if paused:
            self._wanted.clear()
        else:
            self._wanted.set()

    def is_new(self) -> bool:
        """Whether something has changed since this was last asked."""
        before, self._seen = self._seen, self._version
        return before != self._seen

    def close(self) -> None:
        """Ends the thread."""
        self._stop.set()
        self._wanted.set()

    def _run(self) -> None:
        while not self._stop.is_set():
            self._wanted.wait()
            seen = self._session.revisions()
            for robot, pose in self._session.poses().items():
                if self._stop.wait(_PAUSE_S if self._follow(robot, pose) else 0.0):
                    return
            self._session.wait_change(seen, ("poses", "fleet"), 0.5)
            self._stop.wait(0.5)  # poses at most twice a second

    def _follow(self, robot: str, pose: RobotPose) -> bool:
        """Brings one robot up to date; whether it was asked."""
        known = self.known.get(robot)
        if known is not None:
            metres, radians = _apart(known.T_fleet_robot, pose.T_fleet_robot)
            if metres < _STAYED_M and radians < _STAYED_RAD:
                if metres > _MOVED_M or radians > _MOVED_RAD:
                    T = pose.T_fleet_robot
                    self._take(robot, Cloud(known.keyframe, known.version + 1, T, known.points))
                return False
        if time.monotonic() < self._next_s.get(robot, 0.0):
            return False
        given = self._ask(robot, pose, known)
        self._pause_s[robot] = _RETRY_S if given else 2 * self._pause_s.get(robot, _RETRY_S / 2)
        self._next_s[robot] = time.monotonic() + min(self._pause_s[robot], _SELDOM_S)
        return True

    def _ask(self, robot: str, pose: RobotPose, known: Cloud | None) -> bool:
        try:
            view = self._fetch(pose.view)
            points = points_in_robot(view)
        except FleetPoseError as error:
            log.info("points of %s: %s", robot, error)
            return False
        fleet = self._session.fleet
        depth_m = (fleet.depth_m if fleet else None) or 10.0
        packed = points_of_cloud(points, colours_of(points, pose.T_fleet_robot, depth_m))
        number = 1 if known is None else known.keyframe + 1
        version = 1 if known is None else known.version + 1
        self._take(robot, Cloud(number, version, pose.T_fleet_robot, packed))
        return True

    def _take(self, robot: str, cloud: Cloud) -> None:
        self.known[robot] = cloud
        self._version += 1
        self._changed()


def points_in_robot(view: View) -> Floats:
    """(M, 3) some points of a view in its robot's frame, metres.

    Raises:
        CodecError: its cloud is damaged.
    """
    points = some_points_of(view, POINTS).xyz
    T_robot_camera = view.camera.T_robot_camera
    return points @ T_robot_camera[:3, :3].T + T_robot_camera[:3, 3]


def colours_of(points: Floats, T_fleet_robot: Floats, depth_m: float) -> npt.NDArray[np.uint8]:
    """(M, 3) colours by height above the fleet's ground."""
    heights = (points @ T_fleet_robot[2, :3] + T_fleet_robot[2, 3]) / depth_m
    channels = [np.interp(heights, _HEIGHTS, channel) for channel in _COLOURS.T]
    return np.stack(channels, 1).astype(np.uint8).reshape(-1, 3)


def _apart(T_a: Floats, T_b: Floats) -> tuple[float, float]:
    """How far two poses are from each other, metres and radians."""
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    metres = float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3]))
    return metres, float(np.arccos(np.clip(cosine, -1.0, 1.0)))
