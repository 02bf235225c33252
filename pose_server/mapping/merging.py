"""Clouds of many cameras in one frame: what is too uncertain is left out, the rest is thinned to
voxels, camera by camera, so that no more than one dense cloud is held at a time.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import small_gicp

from fleetpose.pose_server.geometry.noise import PointNoise
from fleetpose.pose_server.geometry.se3 import transform

Floats = npt.NDArray[np.floating]

MOST_SIGMA = 0.05
"""Largest depth sigma of a point in the map, share of the scene's depth: what is known worse than a
located robot has to be (`located_sigma`) only blurs the map. The limit is one length for near and
far points, since a map is blurred by metres."""
_VOXELS_PER_SIGMA = 2.0
"""Of depths at the scene's depth: coarser voxels lose what is seen sideways, which is known much
better, and finer ones leave depth noise that they could average."""
_VOXEL_PIXELS = 2.0
"""Least voxel, in pixels at the scene's depth: neighbours of one depth image are one pixel apart,
and thinning begins only where two of them share a voxel."""


@dataclass(frozen=True)
class PlacedCloud:
    """A view's points, and where its camera is.

    Attributes:
        robot: its place in the list of robots.
        T_fleet_camera: (4, 4).
        points: (N, 3) in the camera frame, metres.
        noise: of the camera.
    """

    robot: int
    T_fleet_camera: Floats
    points: Floats
    noise: PointNoise


@dataclass(frozen=True)
class FleetMap:
    """Clouds in one frame.

    Attributes:
        points: (N, 3) float32 in the fleet frame, metres; the mean of what a robot saw in a voxel.
        robot: (N,) uint16, who saw it: the place in `robots`.
        robots: names.
        voxel_m: edge of the voxels.
    """

    points: npt.NDArray[np.float32]
    robot: npt.NDArray[np.uint16]
    robots: tuple[str, ...]
    voxel_m: float


def usual_voxel_m(depth_m: float, noise: PointNoise, focal_px: float) -> float:
    """Edge of a voxel that suits a camera in a scene of this depth: half the sigma of depths there,
    but no less than two pixels.
    """
    sigma_m = float(noise.depth_sigma(np.array(depth_m)))
    return max(sigma_m / _VOXELS_PER_SIGMA, _VOXEL_PIXELS * depth_m / focal_px)


def merge(
    clouds: Iterable[PlacedCloud], robots: Sequence[str], voxel_m: float, most_sigma_m: float
) -> FleetMap:
    """Brings clouds together.

    Voxels lie on one grid, and each robot has its own: where robots see the same there is a point
    of each, so that the map shows whether they agree.

    Args:
        clouds: taken one by one.
        robots: names, in the order that the clouds count in.
        voxel_m: edge of a voxel.
        most_sigma_m: points whose depth sigma is larger are left out.
    """
    found: dict[int, Floats] = {}
    for cloud in clouds:
        kept = cloud.noise.depth_sigma(cloud.points[:, 2]) <= most_sigma_m
        thin = thinned(transform(cloud.T_fleet_camera, cloud.points[kept]), voxel_m)
        before = found.get(cloud.robot)
        if before is not None:
            thin = thinned(np.concatenate((before, thin)), voxel_m)
        found[cloud.robot] = thin
    robot = np.repeat(list(found), [len(points) for points in found.values()])
    points = np.concatenate([np.zeros((0, 3)), *found.values()])
    return FleetMap(points.astype(np.float32), robot.astype(np.uint16), tuple(robots), voxel_m)


def thinned(points: Floats, voxel_m: float) -> Floats:
    """The mean (M, 3) of the points (N, 3) in each voxel of a grid that begins at the origin."""
    if not len(points):
        return points
    return small_gicp.voxelgrid_sampling(points, voxel_m).points()[:, :3]
