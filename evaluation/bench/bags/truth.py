"""Bags for robots, without the truth that they hold: that stays here."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.bench.bags.scenes import Scene
from fleetpose.evaluation.bench.bags.variants import Variant, write
from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.system.observer import SeenView, digest_of
from fleetpose.formats.rotations import pose_of
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.bag.recording import BagRecording
from fleetpose.robot_agent.cameras.base import DepthImage
from fleetpose.robot_agent.features.packing import cloud_of
from fleetpose.rosmsg.bag import Bag
from fleetpose.rosmsg.stamps import header_ns

_TRUTH = "ground_truth/pose"


@dataclass(frozen=True, eq=False)
class RobotBag:
    """A bag that a robot plays, and where the robot truly was.

    Attributes:
        path: of the bag, without truth.
        poses: T_world_camera (4, 4) by the hash of a frame's cloud as it goes on the wire.
    """

    path: Path
    poses: dict[str, Floats]

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        """(4, 4) of the body at a view; None of a view that is not the bag's."""
        T = self.poses.get(seen.digest)
        return None if T is None else T @ inverse(seen.view.camera.T_robot_camera)


def scene_of(source: Path) -> Scene:
    """The colours, depths and true poses of a recorded bag.

    Raises:
        DataFolderError: it has no depth camera, or no true poses.
    """
    bag = Bag(str(source))
    recording = BagRecording(bag, BagOptions())
    try:
        truth = _truth(bag)
        frames = [frame for frame in recording.frames() if frame.stamp_ns in truth]
    finally:
        recording.close()
    depths = [
        np.rint(np.nan_to_num(1000.0 * frame.ranges.depth_m)).astype(np.uint16)
        for frame in frames
        if isinstance(frame.ranges, DepthImage)
    ]
    if not frames or len(depths) < len(frames):
        raise DataFolderError(f"{source} has no depth images with true poses ({_TRUTH})")
    poses = [truth[frame.stamp_ns] for frame in frames]
    K = np.array(frames[0].model.K, np.float64)
    return Scene([f.stamp_ns for f in frames], [f.image for f in frames], depths, poses, K)


def stripped(scene: Scene, path: Path, variant: Variant) -> RobotBag:
    """Writes the bag that a robot gets."""
    path = write(path, scene, variant, "/robot")
    recording = BagRecording(Bag(str(path)), BagOptions())
    try:
        frames = {frame.stamp_ns: frame for frame in recording.frames()}
    finally:
        recording.close()
    poses = {
        digest_of(cloud_of(frames[at].ranges, frames[at].model)): T
        for at, T in zip(scene.stamps_ns, scene.T_world_cameras, strict=True)
        if at in frames
    }
    return RobotBag(path, poses)


def has_truth(source: Path) -> bool:
    """Whether a bag tells where its camera truly was."""
    bag = Bag(str(source))
    try:
        return any(topic.name.endswith(_TRUTH) and topic.count for topic in bag.topics)
    finally:
        bag.close()


def _truth(bag: Bag) -> dict[int, Floats]:
    names = [topic.name for topic in bag.topics if topic.name.endswith(_TRUTH)]
    found = {}
    for message in bag.messages(names):
        if (read := bag.read(message)) is not None:
            q, p = read.pose.orientation, read.pose.position
            found[header_ns(message)] = pose_of(
                np.array([q.w, q.x, q.y, q.z]), np.array([p.x, p.y, p.z])
            )
    return found
