"""Robots in a ring around the rotunda, each with a stereo rig; what they see, and where they
truly are.
"""

import itertools
import threading
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from evaluation.world.person import Person
from evaluation.world.render import Floats, Image
from evaluation.world.town import town_square
from protocol.errors import FleetPoseError
from robot_agent.cameras.rig import StereoRig
from robot_agent.cameras.synthetic import mount

WIDTH, HEIGHT = 640, 480
HFOV_DEG = 62.0
BASELINE_SHARE = 0.05
MAX_SEPARATION_DEG = 45.0
_DEMO_SEPARATIONS_DEG = (45.0, 40.0, 30.0, 45.0, 35.0)
_FIRST_AZIMUTH_DEG = 200.0

# Noise of a small camera, and how far exposures of two eyes and two robots differ.
GREY_SIGMA = 1.5
_GAIN_SIGMA_ROBOT = 0.04
_GAIN_SIGMA_EYE = 0.01

# A walk to and fro along the ring: at most 0.28 m/s at 10 m; neighbours in nearly the same phase
# keep their distance.
_WALK_DEG = 6.0
_WALK_PERIOD_S = 24.0
_WALK_PHASE_STEP = 0.4

# A robot that looks to and fro: at most 4.4 deg/s.
_TURN_DEG = 10.0
_TURN_PERIOD_S = 14.0


@dataclass(frozen=True)
class StereoShot:
    """What the two eyes of a robot see: (H, W, 3) uint8 BGR each, and the robot's true pose at
    that moment.
    """

    left: Image
    right: Image
    T_world_robot: Floats


class RingWorld:
    """A town square and robots that look at its middle. Robots are called r1, r2, ... in ring
    order.

    Safe to use from several threads; the same arguments give the same world.

    Args:
        robots: how many.
        separation_deg: between neighbours; without one they vary, at most 45 degrees. A ring that
            closes is evened out.
        radius_m: of the ring; the rotunda's walls are 2.4 m from the middle, other things up to
            5.5 m.
        seed: of textures, headings and noise.
        moving: the robots walk slowly along the ring.
        turning: names of robots that look to and fro as well.
        person: somebody walks to and fro before the second robot.

    Raises:
        FleetPoseError: a ring that cannot be.
    """

    def __init__(
        self,
        robots: int = 6,
        separation_deg: float | None = None,
        radius_m: float = 10.0,
        seed: int = 0,
        moving: bool = False,
        turning: Collection[str] = (),
        person: bool = False,
    ) -> None:
        if not 1 <= robots <= 360:
            raise FleetPoseError(f"{robots} robots: give 1 to 360")
        if not 8.5 <= radius_m <= 11.5:
            raise FleetPoseError(
                f"ring of {radius_m:g} m: between 8.5 and 11.5 m nothing is in the way"
            )
        if separation_deg is not None and not 0 < separation_deg <= 180:
            raise FleetPoseError(
                f"separation of {separation_deg:g} deg: give more than 0, at most 180"
            )
        self.radius_m = radius_m
        self.moving = moving
        self.names = tuple(f"r{k + 1}" for k in range(robots))
        self.rig = ring_rig(radius_m)
        self._seed = seed
        self._azimuth_deg = _FIRST_AZIMUTH_DEG + ring_azimuths(robots, separation_deg)
        rng = np.random.default_rng((seed, 1))
        self._heading_deg = rng.uniform(-3, 3, robots)
        self._gains = _gains(rng, robots)
        self._still: dict[int, tuple[Image, Image]] = {}
        self._locks = [threading.Lock() for _ in range(robots)]
        self._draws = [0] * robots
        self._turning = frozenset(self.robot_index(name) for name in turning)
        self.scene = town_square(seed)
        self._person = Person(self._azimuth_deg[min(1, robots - 1)]) if person else None
        if self._person is not None:
            self.scene = self.scene.with_quads(self._person.quads(0.0))

    def robot_index(self, robot: str | int) -> int:
        """Which robot a name or an index (from 0) means.

        Raises:
            FleetPoseError: no such robot.
        """
        if isinstance(robot, str) and robot in self.names:
            return self.names.index(robot)
        if isinstance(robot, int) and not isinstance(robot, bool) and 0 <= robot < len(self.names):
            return robot
        raise FleetPoseError(
            f"no robot {robot!r}: the world has {self.names[0]} to {self.names[-1]}"
        )

    def T_world_robot(self, robot: str | int, t_s: float = 0.0) -> Floats:
        """True pose of a robot's body (x forward, y left, z up, on the ground), t seconds after
        the start.
        """
        k = self.robot_index(robot)
        azimuth = self._azimuth_deg[k]
        if self.moving:
            phase = k * _WALK_PHASE_STEP
            turn = 2 * np.pi * t_s / _WALK_PERIOD_S
            azimuth = azimuth + _WALK_DEG * (np.sin(turn + phase) - np.sin(phase))
        turned = _TURN_DEG * np.sin(2 * np.pi * t_s / _TURN_PERIOD_S) if k in self._turning else 0.0
        heading = np.radians(azimuth + 180.0 + self._heading_deg[k] + turned)
        T = np.eye(4)
        T[:2, :2] = ((np.cos(heading), -np.sin(heading)), (np.sin(heading), np.cos(heading)))
        T[:2, 3] = (
            self.radius_m * np.cos(np.radians(azimuth)),
            self.radius_m * np.sin(np.radians(azimuth)),
        )
        return T

    def shoot(self, robot: str | int, t_s: float = 0.0) -> StereoShot:
        """What a robot sees at a time, with the noise of a new exposure."""
        k = self.robot_index(robot)
        T_world_robot = self.T_world_robot(k, t_s)
        with self._locks[k]:
            clean = self._still.get(k) or self._render(T_world_robot, t_s)
            if not self.moving and self._person is None and k not in self._turning:
                self._still[k] = clean
            draw = self._draws[k] = self._draws[k] + 1
        left, right = (
            _exposed(eye, self._gains[k, side], (self._seed, k, side, draw))
            for side, eye in enumerate(clean)
        )
        return StereoShot(left, right, T_world_robot)

    def _render(self, T_world_robot: Floats, t_s: float) -> tuple[Image, Image]:
        scene = self.scene
        if self._person is not None:
            scene = scene.with_last_at(self._person.quads(t_s))
        T_world_left = T_world_robot @ mount()
        T_world_right = T_world_left @ np.linalg.inv(self.rig.T_right_left)
        size = (WIDTH, HEIGHT)
        return (
            scene.image(T_world_left, self.rig.K_left, size),
            scene.image(T_world_right, self.rig.K_right, size),
        )


def ring_rig(radius_m: float) -> StereoRig:
    """The robots' rig: rectified, without distortion, its baseline 5 % of the ring's radius."""
    focal = WIDTH / 2 / np.tan(np.radians(HFOV_DEG) / 2)
    K = np.array(((focal, 0, (WIDTH - 1) / 2), (0, focal, (HEIGHT - 1) / 2), (0, 0, 1.0)))
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -BASELINE_SHARE * radius_m
    return StereoRig(K, np.zeros(5), K, np.zeros(5), T_right_left, (WIDTH, HEIGHT), mount())


def ring_azimuths(robots: int, separation_deg: float | None) -> Floats:
    """Azimuths (N,) in degrees, the first 0; the whole ring, evenly, where the separations would
    close it.
    """
    if separation_deg is None:
        separations = list(itertools.islice(itertools.cycle(_DEMO_SEPARATIONS_DEG), robots - 1))
        closes = robots * MAX_SEPARATION_DEG >= 360
    else:
        separations = [separation_deg] * (robots - 1)
        closes = robots * separation_deg >= 360
    if closes:
        return np.arange(robots) * 360.0 / robots
    return np.concatenate(([0.0], np.cumsum(separations)))


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
