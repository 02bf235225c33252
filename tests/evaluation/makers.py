"""Small recordings with known truth, made by the tests."""

import json
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, inverse, rigid, transform

K = np.array([[200.0, 0.0, 79.5], [0.0, 200.0, 59.5], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 160, 120
KINDS = ("sparse", "sparse_noisy", "stereo_pair_sparse")


def rotation(axis: tuple[float, float, float], angle_deg: float) -> Floats:
    return cv2.Rodrigues(np.radians(angle_deg) * np.asarray(axis, float))[0]


def pose(angle_deg: float = 0.0, t: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Floats:
    """Turned about the vertical axis."""
    return rigid(rotation((0, 1, 0), angle_deg), np.asarray(t, float))


def random_pose(rng: np.random.Generator, angle_deg: float = 40.0) -> Floats:
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return rigid(rotation(tuple(axis), angle_deg), rng.normal(size=3))


def ring_poses(count: int, step_deg: float = 10.0, radius_m: float = 2.0) -> list[Floats]:
    """T_world_camera of cameras on a ring that look at the origin."""
    poses = []
    for k in range(count):
        R = rotation((0, 1, 0), k * step_deg)
        poses.append(rigid(R, R @ np.array([0.0, 0.0, -radius_m])))
    return poses


def write_posed_views(
    folder: Path,
    count: int = 4,
    points: int = 300,
    partners: bool = True,
    c2: float = 0.01,
    step_deg: float = 10.0,
) -> list[Floats]:
    """A posed-views folder of a random cloud around the origin, whose noisy depths are said to be
    known to c2 z^2; returns the T_world_camera.
    """
    rng = np.random.default_rng(5)
    world = rng.uniform(-0.5, 0.5, (points, 3))
    poses = ring_poses(count, step_deg)
    names = [f"photo{k:02d}.png" for k in range(count + 1)]
    for sub in ("images", *KINDS):
        (folder / sub).mkdir(parents=True, exist_ok=True)
    cameras, index = [], {}
    for k, (name, T_world_camera) in enumerate(zip(names, poses, strict=False)):
        T_camera_world = inverse(T_world_camera)
        # view k does not see the points from 20 k on
        seen = np.arange(points - 20 * k)
        xyz = transform(T_camera_world, world[seen])
        uv = (xyz @ K.T)[:, :2] / xyz[:, 2:]
        stem = Path(name).stem
        sigma = c2 * xyz[:, 2] ** 2
        np.savez(folder / "sparse" / stem, uv=uv, xyz_cam=xyz, track_id=seen + 1000)
        np.savez(
            folder / "sparse_noisy" / stem,
            uv=uv, xyz_cam=xyz, track_id=seen + 1000, sigma_z=sigma,
        )  # fmt: skip
        np.savez(folder / "stereo_pair_sparse" / stem, uv=uv, xyz_cam=xyz, partner=names[k ^ 1])
        image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        cv2.imwrite(str(folder / "images" / name), image)
        index[name] = {"partner": names[k ^ 1], "baseline_m": 0.25}
        cameras.append(
            {
                "name": name,
                "width": WIDTH,
                "height": HEIGHT,
                "K": K.tolist(),
                "R_world_to_cam": T_camera_world[:3, :3].tolist(),
                "t_world_to_cam": T_camera_world[:3, 3].tolist(),
                "camera_center_world": T_world_camera[:3, 3].tolist(),
                "ring_angle_deg": float((step_deg * k + 180) % 360),
            }
        )
    (folder / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    if partners:
        (folder / "stereo_pair_sparse" / "index.json").write_text(json.dumps(index))
    return poses


def write_rgbd(folder: Path, count: int = 4, wrong_scale: float = 1.0) -> list[Floats]:
    """An RGB-D folder that looks at a wall 2 m away; `wrong_scale` spoils the rotations."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(6)
    np.savetxt(folder / "camera-intrinsics.txt", K)
    poses = [rigid(np.eye(3), np.array([0.1 * k, 0.0, 0.0])) for k in range(count)]
    for k, T_world_camera in enumerate(poses):
        name = f"frame-{10 * k:06d}"
        depth = rng.integers(1990, 2010, (HEIGHT, WIDTH)).astype(np.uint16)
        depth[:10] = 0
        cv2.imwrite(str(folder / f"{name}.depth.png"), depth)
        image = rng.integers(0, 255, (HEIGHT, WIDTH, 3), np.uint8)
        cv2.imwrite(str(folder / f"{name}.color_registered.jpg"), image)
        recorded = T_world_camera.copy()
        recorded[:3, :3] *= wrong_scale
        np.savetxt(folder / f"{name}.pose.txt", recorded)
    return poses
