"""What made bags show: robots with a depth camera in the synthetic town, as a model of 0.4."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.metrics.geometry import Floats

SIZE = WIDTH, HEIGHT = 640, 480
K = np.array([[525.0, 0, 319.5], [0, 525.0, 239.5], [0, 0, 1.0]])
BEGIN_NS, PERIOD_NS = 1_700_000_000 * 10**9, 10**9 // 3
_SCALE = 0.4  # the town's depths are beyond what a depth camera sees
_FURTHEST_M = 5.9
_STEP_DEG, _APART_DEG = 1.0, 6.0
_RADIUS_M, _HEIGHT_M = 9.0, 1.4


@dataclass(frozen=True, eq=False)
class Scene:
    """What a depth camera saw.

    Attributes:
        stamps_ns: of each frame.
        colours: (H, W, 3) uint8 BGR each.
        depths_mm: (H, W) uint16 each, 0 where there is none.
        T_world_cameras: (4, 4) each.
        K: (3, 3), px.
    """

    stamps_ns: Sequence[int]
    colours: Sequence[npt.NDArray[np.uint8]]
    depths_mm: Sequence[npt.NDArray[np.uint16]]
    T_world_cameras: Sequence[Floats]
    K: Floats

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        height, width = self.depths_mm[0].shape
        return width, height


def walks(robots: int, frames: int) -> list[Scene]:
    """Robots that walk side by side along a ring and look at its middle."""
    from fleetpose.evaluation.simulate.world import town_square

    town = town_square(0)
    return [_walk(town, _APART_DEG * robot, frames) for robot in range(robots)]


def _walk(town: Any, begin_deg: float, frames: int) -> Scene:
    colours, depths, poses = [], [], []
    for k in range(frames):
        T = _looking_in(begin_deg + _STEP_DEG * k)
        seen = town.render(T, K, SIZE)
        depth_m = np.nan_to_num(_SCALE * seen.depth, nan=np.inf)
        mm = np.where(depth_m < _FURTHEST_M, np.rint(1000 * np.minimum(depth_m, 60)), 0)
        T[:3, 3] *= _SCALE
        colours.append(seen.image)
        depths.append(mm.astype(np.uint16))
        poses.append(T)
    stamps_ns = [BEGIN_NS + k * PERIOD_NS for k in range(frames)]
    return Scene(stamps_ns, colours, depths, poses, K)


def _looking_in(azimuth_deg: float) -> Floats:
    """T_world_camera (4, 4) from a place on the ring."""
    angle = np.radians(azimuth_deg)
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    down = np.array([0.0, 0.0, -1.0])
    T = np.eye(4)
    T[:3, :3] = np.column_stack((np.cross(down, -outward), down, -outward))
    T[:3, 3] = _RADIUS_M * outward + (0, 0, _HEIGHT_M)
    return T
