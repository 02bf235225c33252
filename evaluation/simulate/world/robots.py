"""Robots in a textured world, each with a stereo rig: their names, their eyes, their noise."""

import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from fleetpose.evaluation.simulate.world.render import Floats, Image, Renderer
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.synthetic import mount

WIDTH, HEIGHT = 640, 480
HFOV_DEG = 62.0

# Noise of a small camera, and how far exposures of two eyes and two robots differ.
GREY_SIGMA = 1.5
_GAIN_SIGMA_ROBOT = 0.04
_GAIN_SIGMA_EYE = 0.01


@dataclass(frozen=True)
class StereoShot:
    """What the two eyes of a robot see: (H, W, 3) uint8 BGR each, and the robot's true pose at
    that moment.
    """

    left: Image
    right: Image
    T_world_robot: Floats


class World(ABC):
    """A scene and robots in it, called r1, r2, ... Safe to use from several threads.

    Args:
        robots: how many.
        rig: of each.
        scene: what they see.
        rng: of their exposures.
        seed: of their noise.
        radius_m: half the width of the place that the robots are in.

    Raises:
        FleetPoseError: too few or too many robots.
    """

    def __init__(
        self,
        robots: int,
        rig: StereoRig,
        scene: Renderer,
        rng: np.random.Generator,
        seed: int,
        radius_m: float,
    ) -> None:
        self.names = robot_names(robots)
        self.rig = rig
        self.scene = scene
        self.radius_m = radius_m
        self._seed = seed
        self._gains = _gains(rng, robots)
        self._still: dict[int, tuple[Image, Image]] = {}
        self._locks = [threading.Lock() for _ in range(robots)]
        self._draws = [0] * robots

    @abstractmethod
    def T_world_robot(self, robot: str | int, t_s: float = 0.0) -> Floats:
        """True pose of a robot's body (x forward, y left, z up, on the ground), t seconds after
        the start.
        """

    def _stands_still(self, k: int) -> bool:
        """Whether a robot sees the same at all times."""
        del k
        return True

    def _scene_at(self, t_s: float) -> Renderer:
        del t_s
        return self.scene

    def robot_index(self, robot: str | int) -> int:
        """Which robot a name or an index (from 0) means.

        Raises:
            FleetPoseError: no such robot.
        """
        return index_of(self.names, robot)

    def shoot(self, robot: str | int, t_s: float = 0.0) -> StereoShot:
        """What a robot sees at a time, with the noise of a new exposure."""
        k = self.robot_index(robot)
        T_world_robot = self.T_world_robot(k, t_s)
        with self._locks[k]:
            clean = self._still.get(k) or self._render(T_world_robot, t_s)
            if self._stands_still(k):
                self._still[k] = clean
            draw = self._draws[k] = self._draws[k] + 1
        left, right = (
            _exposed(eye, self._gains[k, side], (self._seed, k, side, draw))
            for side, eye in enumerate(clean)
        )
        return StereoShot(left, right, T_world_robot)

    def _render(self, T_world_robot: Floats, t_s: float) -> tuple[Image, Image]:
        scene = self._scene_at(t_s)
        T_world_left = T_world_robot @ mount()
        T_world_right = T_world_left @ np.linalg.inv(self.rig.T_right_left)
        size = (WIDTH, HEIGHT)
        return (
            scene.image(T_world_left, self.rig.K_left, size),
            scene.image(T_world_right, self.rig.K_right, size),
        )


def robot_names(robots: int) -> tuple[str, ...]:
    """Names of so many robots.

    Raises:
        FleetPoseError: too few or too many.
    """
    if not 1 <= robots <= 360:
        raise FleetPoseError(f"{robots} robots: give 1 to 360")
    return tuple(f"r{k + 1}" for k in range(robots))


def index_of(names: tuple[str, ...], robot: str | int) -> int:
    """Which robot a name or an index (from 0) means.

    Raises:
        FleetPoseError: no such robot.
    """
    if isinstance(robot, str) and robot in names:
        return names.index(robot)
    if isinstance(robot, int) and not isinstance(robot, bool) and 0 <= robot < len(names):
        return robot
    raise FleetPoseError(f"no robot {robot!r}: the world has {names[0]} to {names[-1]}")


def standing(place: Floats, heading_deg: float) -> Floats:
    """`T_world_robot` (4, 4) of a robot on the ground at a place (2,)."""
    heading = np.radians(heading_deg)
    T = np.eye(4)
    T[:2, :2] = ((np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading)))
    T[:2, 3] = place
    return T


def rig_with(baseline_m: float) -> StereoRig:
    """The robots' rig: rectified, without distortion."""
    focal = WIDTH / 2 / np.tan(np.radians(HFOV_DEG) / 2)
    K = np.array(((focal, 0, (WIDTH - 1) / 2), (0, focal, (HEIGHT - 1) / 2), (0, 0, 1.0)))
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -baseline_m
    return StereoRig(K, np.zeros(5), K, np.zeros(5), T_right_left, (WIDTH, HEIGHT), mount())


def _gains(rng: np.random.Generator, robots: int) -> Floats:
    """Exposure of both eyes (N, 2) relative to 1."""
    robot = rng.normal(0, _GAIN_SIGMA_ROBOT, (robots, 1))
    eye = rng.normal(0, _GAIN_SIGMA_EYE, (robots, 2))
    return 1 + np.clip(robot + eye, -0.1, 0.1)


def _exposed(image: Image, gain: float, draw: tuple[int, ...]) -> Image:
    """An exposure: gain, then noise that depends on nothing but the number of the draw."""
    noise = np.random.default_rng(draw).standard_normal(image.shape, np.float32)
    grey = image * np.float32(gain) + np.float32(GREY_SIGMA) * noise
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)
