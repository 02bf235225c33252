"""A made-up scene for alignment tests: textured points on a few slanted walls, seen by two
cameras.
"""

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform
from fleetpose.protocol.clouds import SalientPoints, encode_salient, encode_scattered
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel, View, ViewName

Floats = npt.NDArray[np.float64]
K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
SIZE = (640, 480)
EPOCH = "0" * 12
PIXEL_SIGMA = 0.5
DEPTH_SHARE = 0.01  # sigma(z) / z at the scene's depth


def turned(yaw_deg: float, depth_m: float = 10.0) -> Floats:
    """T_i_j of a camera that walked round the middle of the scene."""
    R = exp_so3(np.array([0.0, np.radians(yaw_deg), 0.0]))
    centre = np.array([0.0, 0.0, depth_m])
    return make_pose(R, centre - R @ centre)


def walls(rng: np.random.Generator, count: int = 800, depth_m: float = 10.0) -> Floats:
    """Points (N, 3) of three walls in front of camera i."""
    xy = rng.uniform(-0.45, 0.45, (count, 2)) * depth_m
    z = depth_m * (1.0 + 0.15 * np.sign(xy[:, 0]) + 0.2 * xy[:, 0] / depth_m)
    return np.column_stack((xy, z + 0.05 * depth_m * (xy[:, 1] > 0)))


def descriptors(rng: np.random.Generator, count: int) -> npt.NDArray[np.uint8]:
    return rng.integers(0, 100, (count, 64), dtype=np.uint8)


def view(
    rng: np.random.Generator,
    robot: str,
    points: Floats,
    looks: npt.NDArray[np.uint8],
    T_camera_scene: Floats,
    seq: int = 0,
    noisy: bool = True,
) -> View:
    """What a camera with scattered depth sees of the points, with its own noise."""
    seen = transform(T_camera_scene, points)
    depth_m = float(np.median(seen[:, 2]))
    uv = (seen @ K.T)[:, :2] / seen[:, 2:]
    inside = (seen[:, 2] > 0) & ((uv > 2) & (uv < np.array(SIZE) - 3)).all(axis=1)
    uv, z, looks = uv[inside], seen[inside, 2], looks[inside]
    c2 = DEPTH_SHARE / depth_m
    if noisy:
        uv = uv + rng.normal(0, PIXEL_SIGMA, uv.shape)
        q = 1 / z + rng.normal(0, c2, len(z))
    else:
        q = 1 / z
    salient = SalientPoints(
        uv.astype(np.float32), q.astype(np.float32), np.full(len(q), c2, np.float32), looks
    )
    noise = NoiseModel(pixel_sigma_px=PIXEL_SIGMA, depth_sigma_m=(0.0, 0.0, c2))
    return View(
        name=ViewName(robot=robot, epoch=EPOCH, seq=seq),
        stamp_ns=seq,
        camera=Camera(
            width=SIZE[0],
            height=SIZE[1],
            K=K,
            T_robot_camera=ROBOT_FROM_CAMERA,
            noise=noise,
            kind="views",
        ),
        cloud=encode_scattered(uv, 1 / q, 1e-4 * depth_m),
        salient=encode_salient(salient),
    )


def pair_of_views(
    rng: np.random.Generator, T_i_j: Floats, depth_m: float = 10.0, count: int = 800
) -> tuple[View, View]:
    """Two robots' views of one scene."""
    points, looks = walls(rng, count, depth_m), descriptors(rng, count)
    return (
        view(rng, "r1", points, looks, np.eye(4)),
        view(rng, "r2", points, looks, inverse(T_i_j)),
    )


def observed_pair(rng: np.random.Generator, T_i_j: Floats, count: int) -> tuple[Observed, Observed]:
    """Matched salient points, the k-th of one view being the k-th of the other."""
    points = walls(rng, count)
    sides = []
    for T in (np.eye(4), inverse(T_i_j)):
        seen = transform(T, points)
        uv = (seen @ K.T)[:, :2] / seen[:, 2:] + rng.normal(0, PIXEL_SIGMA, (count, 2))
        sigma = np.full(count, DEPTH_SHARE / 10.0)
        q = 1 / seen[:, 2] + rng.normal(0, sigma)
        sides.append(Observed(K, SIZE, uv, q, sigma, PIXEL_SIGMA))
    return sides[0], sides[1]
