"""Robots in a ring around the rotunda, each with a stereo rig; what they see, and where they
truly are.
"""

import itertools
from collections.abc import Collection

import numpy as np

from fleetpose.evaluation.simulate.world.person import Person
from fleetpose.evaluation.simulate.world.render import Floats, Renderer
from fleetpose.evaluation.simulate.world.robots import (
    World,
    index_of,
    rig_with,
    robot_names,
    standing,
)
from fleetpose.evaluation.simulate.world.town import town_square
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig

BASELINE_SHARE = 0.05
MAX_SEPARATION_DEG = 45.0
_DEMO_SEPARATIONS_DEG = (45.0, 40.0, 30.0, 45.0, 35.0)
_FIRST_AZIMUTH_DEG = 200.0

# A walk to and fro along the ring: at most 0.28 m/s at 10 m; neighbours in nearly the same phase
# keep their distance.
_WALK_DEG = 6.0
_WALK_PERIOD_S = 24.0
_WALK_PHASE_STEP = 0.4

# A robot that looks to and fro: at most 4.4 deg/s.
_TURN_DEG = 10.0
_TURN_PERIOD_S = 14.0


class RingWorld(World):
    """A town square and robots that look at its middle, named in ring order.

    The same arguments give the same world.

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
        names = robot_names(robots)
        if not 8.5 <= radius_m <= 11.5:
            raise FleetPoseError(
                f"ring of {radius_m:g} m: between 8.5 and 11.5 m nothing is in the way"
            )
        if separation_deg is not None and not 0 < separation_deg <= 180:
            raise FleetPoseError(
                f"separation of {separation_deg:g} deg: give more than 0, at most 180"
            )
        self.moving = moving
        self._azimuth_deg = _FIRST_AZIMUTH_DEG + ring_azimuths(robots, separation_deg)
        rng = np.random.default_rng((seed, 1))
        self._heading_deg = rng.uniform(-3, 3, robots)
        self._turning = frozenset(index_of(names, name) for name in turning)
        scene = town_square(seed)
        self._person = Person(self._azimuth_deg[min(1, robots - 1)]) if person else None
        if self._person is not None:
            scene = scene.with_quads(self._person.quads(0.0))
        super().__init__(robots, ring_rig(radius_m), scene, rng, seed, radius_m)

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
        heading_deg = azimuth + 180.0 + self._heading_deg[k] + turned
        place = self.radius_m * np.array((np.cos(np.radians(azimuth)), np.sin(np.radians(azimuth))))
        return standing(place, heading_deg)

    def _stands_still(self, k: int) -> bool:
        return not self.moving and self._person is None and k not in self._turning

    def _scene_at(self, t_s: float) -> Renderer:
        if self._person is None:
            return self.scene
        return self.scene.with_last_at(self._person.quads(t_s))


def ring_rig(radius_m: float) -> StereoRig:
    """The robots' rig, its baseline 5 % of the ring's radius."""
    return rig_with(BASELINE_SHARE * radius_m)


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
