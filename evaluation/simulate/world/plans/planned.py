"""Robots in one of the plans that fool: where they stand, what they see, where they truly are."""

from collections.abc import Sequence

import numpy as np

from fleetpose.evaluation.simulate.world.materials.textures import Rng
from fleetpose.evaluation.simulate.world.plans.indoors import INDOORS
from fleetpose.evaluation.simulate.world.plans.outdoors import OUTDOORS
from fleetpose.evaluation.simulate.world.plans.plan import Front, Plan
from fleetpose.evaluation.simulate.world.plans.things import unique_things
from fleetpose.evaluation.simulate.world.render import Floats, Renderer
from fleetpose.evaluation.simulate.world.robots import World, rig_with, robot_names, standing
from fleetpose.protocol.errors import FleetPoseError

PLANS = {**OUTDOORS, **INDOORS}
"""Makes a plan from a generator, by name."""

_NEXT_SIGMA_M = 1.5  # from what one robot looks at to what the next one does
_ALIKE_SHARE = 0.3  # of the robots look at an alike place instead
_ANYWHERE_SHARE = 0.1  # of them at any place
_LOOK_SIDE_DEG = 8.0  # from what a robot looks at to the middle of its image, at most
_TRIES = 2000
_SEED_TEXTURES, _SEED_ROBOTS, _SEED_EXPOSURES = 0, 1, 2  # beside the world's seed


class PlanWorld(World):
    """A plan with unique things in it, and robots that stand still. The same arguments give the
    same world; other numbers of unique things change neither textures nor robots.

    Args:
        plan: its name.
        robots: how many.
        unique: how many unique things stand about.
        seed: of textures, robots, unique things and noise.

    Raises:
        FleetPoseError: no such plan, or it has no room for the robots.
    """

    def __init__(self, plan: str, robots: int, unique: int = 0, seed: int = 0) -> None:
        robot_names(robots)
        self.plan = plan_named(plan, seed)
        things = unique_things(self.plan.fronts, unique, self.plan.clear_m - 0.3, seed)
        rng = np.random.default_rng((seed, _SEED_ROBOTS))
        self._T_world_robots = stations(self.plan, robots, rng)
        half_m = max(float(np.abs(one.high - one.low).max()) / 2 for one in self.plan.rooms)
        super().__init__(
            robots,
            rig_with(self.plan.baseline_m),
            Renderer([*self.plan.quads, *things], overcast()),
            np.random.default_rng((seed, _SEED_EXPOSURES)),
            seed,
            half_m,
        )

    def T_world_robot(self, robot: str | int, t_s: float = 0.0) -> Floats:
        return self._T_world_robots[self.robot_index(robot)]


def plan_named(name: str, seed: int) -> Plan:
    """A plan with the textures and measures of a seed.

    Raises:
        FleetPoseError: no such plan.
    """
    if name not in PLANS:
        raise FleetPoseError(f"no plan '{name}': there are {', '.join(sorted(PLANS))}")
    return PLANS[name](np.random.default_rng((seed, _SEED_TEXTURES)))


def stations(plan: Plan, robots: int, rng: Rng) -> tuple[Floats, ...]:
    """`T_world_robot` (4, 4) of robots that look at places near the one before's, or at alike ones.

    Raises:
        FleetPoseError: no place is left to stand at.
    """
    found: list[Floats] = []
    target, front = _anywhere(plan.fronts, rng)
    for _ in range(_TRIES * robots):
        if len(found) == robots:
            return tuple(found)
        looked_at, at_front = (target, front) if not found else _next(plan, target, front, rng)
        pose = _before(plan, looked_at, at_front, rng)
        if pose is not None:
            found.append(pose)
            target, front = looked_at, at_front
    raise FleetPoseError(f"{robots} robots: no room for more than {len(found)}")


def _next(plan: Plan, target: Floats, front: Front, rng: Rng) -> tuple[Floats, Front]:
    """What the next robot looks at."""
    chance = rng.uniform()
    if chance < _ANYWHERE_SHARE:
        return _anywhere(plan.fronts, rng)
    if chance < _ANYWHERE_SHARE + _ALIKE_SHARE and plan.symmetries:
        T = plan.symmetries[int(rng.integers(len(plan.symmetries)))]
        target = (T @ np.append(target, (0.0, 1.0)))[:2]
    target = target + rng.normal(0.0, _NEXT_SIGMA_M) * (front.b - front.a) / front.length_m
    return _onto(plan.fronts, target)


def _anywhere(fronts: Sequence[Front], rng: Rng) -> tuple[Floats, Front]:
    lengths = np.array([one.length_m for one in fronts])
    front = fronts[int(rng.choice(len(fronts), p=lengths / lengths.sum()))]
    return front.place(float(rng.uniform(0.0, front.length_m)), 0.0), front


def _onto(fronts: Sequence[Front], target: Floats) -> tuple[Floats, Front]:
    """The place on any front that is nearest to a place (2,)."""
    feet = []
    for one in fronts:
        along = float(np.clip((target - one.a) @ (one.b - one.a) / one.length_m, 0, one.length_m))
        feet.append(one.place(along, 0.0))
    nearest = int(np.argmin([np.linalg.norm(foot - target) for foot in feet]))
    return feet[nearest], fronts[nearest]


def _before(plan: Plan, target: Floats, front: Front, rng: Rng) -> Floats | None:
    """A robot that looks at a place on a front, from any side and distance; none if it would stand
    in the way of something.
    """
    bearing = np.radians(rng.uniform(-plan.bearing_deg, plan.bearing_deg))
    distance_m = rng.uniform(*plan.distance_m)
    step = front.T_world_front[:2, :2] @ (np.sin(bearing), -np.cos(bearing))
    place = target + distance_m * step
    heading_deg = np.degrees(np.arctan2(-step[1], -step[0])) + rng.uniform(
        -_LOOK_SIDE_DEG, _LOOK_SIDE_DEG
    )
    free = any(one.holds(place, plan.clear_m) and one.holds(target) for one in plan.rooms)
    return standing(place, float(heading_deg)) if free else None


def overcast() -> np.ndarray:
    """A sky without clouds or sun: no direction is told by it."""
    up = np.linspace(1, 0, 64, dtype=np.float32)[:, None, None]
    light, horizon = np.array((222, 214, 208), np.float32), np.array((236, 232, 228), np.float32)
    return np.tile(up * light + (1 - up) * horizon, (1, 16, 1))
