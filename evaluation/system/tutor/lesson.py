"""The built-in lesson: a fleet in two pieces before a facade of equal windows, made on the fly.

It is the recording of a site like any other, and the truth in a file beside it that nobody but the
tutor reads.
"""

import itertools
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.simulate.world import World
from fleetpose.evaluation.simulate.world.build import Builder
from fleetpose.evaluation.simulate.world.plans.outdoors import bay, strip
from fleetpose.evaluation.simulate.world.plans.plan import Front, front, placed, shifted
from fleetpose.evaluation.simulate.world.plans.planned import overcast
from fleetpose.evaluation.simulate.world.plans.things import unique_things
from fleetpose.evaluation.simulate.world.render import Quad, Renderer
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH, rig_with, standing
from fleetpose.evaluation.system.tutor.truths import ExactTruth, truth_beside
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import ImageHeader, View, ViewName
from fleetpose.protocol.recording.file import Recorder
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import ENCODING_JPEG
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.synthetic import mount
from fleetpose.robot_agent.features.keypoints import salient_points
from fleetpose.robot_agent.features.packing import view_of
from fleetpose.robot_agent.recent_views import kept_view

EDITION = 1  # of the lesson: a kept one of another edition is made anew
APART = ("r4", "r5")  # the piece that the machine may not join: the learner is to
SITE = "lesson"
PERIOD_M = 3.14  # one window further
_SEED, _MATERIAL = 4, "stone"
_BAYS, _EQUAL = 6, (0, 1)  # on either side of the origin; those that are equal
_BASELINE_M = 0.35
_STRIP_M = 1.2  # before the facade, in which things stand
# where unique things hang or stand along the facade (m), and the seeds that they are made by
_THINGS = ((-5.0, 0), (-2.8, 6), (-1.2, 1), (2.0, 7), (3.3, 8), (5.6, 3), (7.4, 9))
# along and before the facade (m), and how far from its normal the robot looks (deg)
_PLACES = ((-3.6, 7.5, 6.0), (-1.9, 6.8, -5.0), (0.5, 7.6, 4.0), (2.2, 7.2, -4.0), (4.1, 7.8, -6.0))
_FACADE_Y_M = -0.4  # what things hang on
_HALF_WIDTH_M = 5.0  # of where they stand
_SALIENT = 1600


@dataclass(frozen=True)
class Step:
    """How far a lesson is made."""

    done: int
    of: int
    what: str


class LessonWorld(World):
    """Five robots before a facade that repeats, with a few unique things on it; all stand still."""

    def __init__(self, places: tuple[tuple[float, float, float], ...] = _PLACES) -> None:
        things = [q for x, seed in _THINGS for q in unique_things(_spot(x), 1, _STRIP_M, seed)]
        self._T_world_robots = tuple(
            standing(np.array((x, -y)), 90.0 - turned) for x, y, turned in places
        )
        super().__init__(
            len(places),
            rig_with(_BASELINE_M),
            Renderer([*_facade(), *things], overcast()),
            np.random.default_rng((_SEED, 0)),
            _SEED,
            _HALF_WIDTH_M,
        )

    def T_world_robot(self, robot: str | int, t_s: float = 0.0) -> Floats:
        return self._T_world_robots[self.robot_index(robot)]


def _spot(along_m: float) -> tuple[Front]:
    """So short a piece of the facade that whatever stands at it stands there."""
    return (front((along_m - 0.01, _FACADE_Y_M), (along_m + 0.01, _FACADE_Y_M)),)


def _facade() -> list[Quad]:
    """A row of bays: some in the middle are equal to the last texel, none of the others is."""
    equal = _painted(0)
    others = {k: _painted(k) for k in range(-_BAYS, _BAYS) if k not in _EQUAL}
    return [
        quad
        for k in range(-_BAYS, _BAYS)
        for quad in placed(others.get(k, equal), shifted(k * PERIOD_M))
    ]


def _painted(number: int) -> list[Quad]:
    """A bay with the ground before it, at the origin."""
    b = Builder(np.random.default_rng((_SEED, _BAYS + number)))
    bay(b, PERIOD_M, _MATERIAL)
    strip(b, PERIOD_M)
    return b.quads


def lesson_in(folder: Path, tell: Callable[[Step], None] = lambda _: None) -> Path:
    """The lesson's recording in a folder, made if it is not there yet.

    Args:
        folder: where lessons are kept.
        tell: hears how far it is.
    """
    path = folder / f"lesson-{EDITION}.mcap"
    if path.exists() and truth_beside(path).exists():
        return path
    folder.mkdir(parents=True, exist_ok=True)
    part = folder / f"making-{os.getpid()}.mcap"
    try:
        truth = _write(part, tell)
        truth.save(truth_beside(path))
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _write(path: Path, tell: Callable[[Step], None]) -> ExactTruth:
    """Writes what each robot would send; returns where it is and how far all it sees."""
    tell(Step(0, len(_PLACES), "painting the facade"))
    world = LessonWorld()
    matcher = StereoMatcher(world.rig)
    depths: dict[str, Floats] = {}
    with Recorder(path, SITE, library="hmi-client tutor") as recorder:
        for k, robot in enumerate(world.names):
            tell(Step(k, len(_PLACES), f"{robot} looks at it"))
            for key, payload, encoding, attachment in _sent(world, matcher, robot):
                recorder.note("in", Sample(key, payload, encoding, attachment))
            T_world_camera = world.T_world_robot(robot) @ mount()
            exact = world.scene.depth(T_world_camera, world.rig.K_left, (WIDTH, HEIGHT))
            depths[robot] = exact.astype(np.float64)
    tell(Step(len(_PLACES), len(_PLACES), "the lesson is made"))
    poses = {robot: world.T_world_robot(robot) for robot in world.names}
    return ExactTruth(poses, depths, np.array((PERIOD_M, 0.0, 0.0)))


def _sent(
    world: LessonWorld, matcher: StereoMatcher, robot: str
) -> list[tuple[str, bytes, str, bytes | None]]:
    """Key, payload, encoding and attachment of a robot's view and of its image."""
    shot, stamp_ns = world.shoot(robot), time.time_ns()
    frame = matcher.frame(shot.left, shot.right, stamp_ns)
    salient = salient_points(frame.image, frame.ranges, frame.model, _SALIENT)
    name = ViewName(robot=robot, epoch="0" * 12, seq=0)
    kept = kept_view(view_of(name, frame, salient), frame.image)
    assert kept.jpeg is not None
    keys, header = Keys(SITE), ImageHeader(view=name, stamp_ns=stamp_ns)
    return [
        (keys.cloud(robot), pack(kept.view), encoding_of(View), None),
        (keys.image(robot), kept.jpeg, ENCODING_JPEG, pack(header)),
    ]


def pairs_across(robots: tuple[str, ...], apart: tuple[str, ...]) -> list[tuple[str, str]]:
    """Pairs of which one robot is apart and the other is not."""
    return [(a, b) for a, b in itertools.combinations(robots, 2) if (a in apart) != (b in apart)]
