"""Where a recorded view truly was, and what its pixels show: exactly, or as its recording ended."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from fleetpose.evaluation.bench.replay.inputs import Recorded
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.messages import RobotPose, View
from fleetpose.protocol.recording.file import Recording

_SAME_SURFACE = 0.05  # depths of neighbouring pixels differ by less, as a share
_NEAR_PX = 6.0  # to a point of the cloud that has a pixel's depth


class Truth(Protocol):
    """What points are held against. Frames: any common one (world), and the robot's body.

    Attributes:
        against: what that is, in words.
        repeats_m: (3,) step in the world after which all looks the same; none if not known.
    """

    @property
    def against(self) -> str: ...

    @property
    def repeats_m(self) -> Floats | None: ...

    def T_world_robot(self, view: View) -> Floats | None:
        """(4, 4) pose of the body at a recorded view; none if it is not known."""
        ...

    def gauge(self, view: View) -> object:
        """Poses compare only where this is the same."""
        ...

    def depth_at(self, view: View, pixel: Floats) -> float | None:
        """Depth along the optical axis, metres, at a pixel (2,); none where nothing is known."""
        ...


def truth_beside(recording: Path) -> Path:
    """The file of a lesson's truth."""
    return recording.with_suffix(".truth.npz")


@dataclass(frozen=True)
class ExactTruth:
    """Of robots that stand still in a made world.

    Args:
        T_world_robots: (4, 4) by robot.
        depths: (H, W) metres at pixel centres by robot, nan in the sky.
        repeats_m: (3,) after which the world looks the same.
    """

    T_world_robots: dict[str, Floats]
    depths: dict[str, Floats]
    repeats_m: Floats | None = None
    against: str = "the true poses and depths"

    def T_world_robot(self, view: View) -> Floats | None:
        return self.T_world_robots.get(view.name.robot)

    def gauge(self, view: View) -> object:
        del view
        return ()

    def depth_at(self, view: View, pixel: Floats) -> float | None:
        return depth_in(self.depths[view.name.robot], pixel)

    def save(self, path: Path) -> None:
        """Writes it."""
        arrays = {f"pose/{robot}": T for robot, T in self.T_world_robots.items()}
        arrays |= {f"depth/{robot}": depth for robot, depth in self.depths.items()}
        if self.repeats_m is not None:
            arrays["repeats_m"] = self.repeats_m
        np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]

    @classmethod
    def read(cls, path: Path) -> "ExactTruth":
        """Reads what `save` wrote."""
        with np.load(path) as arrays:
            by_kind: dict[str, dict[str, Floats]] = {"pose": {}, "depth": {}}
            for name in arrays.files:
                kind, _, robot = name.partition("/")
                if robot:
                    by_kind[kind][robot] = arrays[name]
            repeats_m = arrays["repeats_m"] if "repeats_m" in arrays.files else None
        return cls(by_kind["pose"], by_kind["depth"], repeats_m)


def depth_in(depth: Floats, pixel: Floats) -> float | None:
    """Depth at a pixel (2,) of an exact depth image (H, W); none in the sky and outside.

    Inverse depth is affine in the pixel on a plane: between pixels of one surface it is
    interpolated, which is exact there; beside an edge the nearest pixel's counts.
    """
    height, width = depth.shape
    u, v = float(pixel[0]), float(pixel[1])
    if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
        return None
    nearest = float(depth[round(v), round(u)])
    left, top = min(max(int(u), 0), width - 2), min(max(int(v), 0), height - 2)
    four = depth[top : top + 2, left : left + 2].astype(np.float64)
    if not np.isfinite(nearest):
        return None
    if not np.all(np.abs(four - nearest) < _SAME_SURFACE * nearest):  # also where one is nan
        return nearest
    du, dv = u - left, v - top
    weights = np.outer((1 - dv, dv), (1 - du, du))
    return float(1.0 / (weights / four).sum())


@dataclass(frozen=True)
class FinalPoses:
    """Where a recording's own server had put its views in the end, and the depths the robots sent.

    Args:
        poses: the last that was told of each view, by its recorded name.
    """

    poses: dict[str, RobotPose] = field(default_factory=dict)
    repeats_m: Floats | None = None
    against: str = "the recording's final poses"

    @classmethod
    def of(cls, recording: Recording) -> "FinalPoses":
        """Reads the recording once."""
        told = Recorded.of(recording).poses
        return cls({str(name): pose for name, pose in told.items() if pose.located})

    def T_world_robot(self, view: View) -> Floats | None:
        pose = self.poses.get(str(view.name))
        return None if pose is None else pose.T_fleet_robot

    def gauge(self, view: View) -> object:
        pose = self.poses.get(str(view.name))
        return pose and (pose.server_epoch, pose.gauge_revision, pose.component)

    def depth_at(self, view: View, pixel: Floats) -> float | None:
        points = points_of(view)
        apart = np.linalg.norm(points.uv - pixel, axis=1)
        if not len(apart) or apart.min() > _NEAR_PX:
            return None
        return float(points.xyz[apart.argmin(), 2])
