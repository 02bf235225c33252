"""Two moving robots: what each of them sends, view by view, and where it truly is."""

import random
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from fleetpose.evaluation.data.anonymize import random_name, strip
from fleetpose.evaluation.data.parts import parts_of
from fleetpose.evaluation.data.recording import Recording
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.errors import DataFolderError

if TYPE_CHECKING:
    from fleetpose.robot_agent.cameras.base import Frame


@dataclass(frozen=True)
class Walk:
    """One robot's views in order: files with what it sent, and (N, 4, 4) true T_world_camera."""

    wires: tuple[Path, ...]
    T_world_cameras: Floats

    def part(self, first: int, count: int, step: Literal[1, -1]) -> "Walk":
        """So many views from one on, walked forward or back."""
        chosen = [first + step * k for k in range(count)]
        return Walk(tuple(self.wires[k] for k in chosen), self.T_world_cameras[chosen])


def recorded_walk(recording: Recording, robot: int, views: int, folder: Path) -> Walk:
    """What one of two robots sends that share an RGB-D recording, each a contiguous half; runs in a
    worker.

    Raises:
        DataFolderError: the recording is no walk, or has too few frames.
    """
    from fleetpose.robot_agent.cameras.factory import open_camera

    if not recording.is_rgbd:
        raise DataFolderError(
            f"{recording.directory} holds posed views, and robots that move are needed: give an "
            "RGB-D folder, or leave --data out for the synthetic world"
        )
    part = parts_of(recording, 2, 0)[robot]
    if len(part) < views:
        raise DataFolderError(
            f"{recording.directory}: {len(part)} frames for each of two robots, need {views}; give "
            f"--views {len(part) - 1}"
        )
    rng = random.Random()
    name = random_name(rng)
    stripped = strip(recording, part, folder / name, rng)
    frames = list(open_camera(stripped.camera, str(stripped.path), "once").frames())
    return Walk(_sent(name, frames, folder), np.array([view.T_world_camera for view in part]))


def world_walk(separation_deg: float, seed: int, robot: int, views: int, folder: Path) -> Walk:
    """What one of two robots sends that walk in the synthetic world, a view a second; runs in a
    worker.
    """
    from fleetpose.evaluation.simulate.world import RingWorld
    from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher

    world = RingWorld(2, separation_deg, seed=seed, moving=True)
    matcher = StereoMatcher(world.rig)
    frames, poses = [], []
    for second in range(views):
        shot = world.shoot(robot, float(second))
        frame = matcher.frame(shot.left, shot.right, 0)
        frames.append(frame)
        poses.append(shot.T_world_robot @ frame.model.T_robot_camera)
    return Walk(_sent(random_name(random.Random()), frames, folder), np.array(poses))


def _sent(robot: str, frames: Sequence["Frame"], folder: Path) -> tuple[Path, ...]:
    from fleetpose.protocol import codec
    from fleetpose.protocol.keys import new_epoch
    from fleetpose.protocol.messages import ViewName
    from fleetpose.robot_agent.features.keypoints import salient_points
    from fleetpose.robot_agent.features.packing import view_of

    epoch, wires = new_epoch(), []
    for seq, frame in enumerate(frames):
        salient = salient_points(frame.image, frame.ranges, frame.model)
        name = ViewName(robot=robot, epoch=epoch, seq=seq)
        wires.append(folder / f"{robot}-{seq:03d}.msgpack")
        wires[-1].write_bytes(codec.pack(view_of(name, frame, salient)))
    return tuple(wires)
