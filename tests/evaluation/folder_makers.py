"""Small recordings of a made-up room in the folders of known benchmarks."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from fleetpose.formats.kitti import write_kitti, write_times
from fleetpose.formats.rotations import pose_of, quat_wxyz
from fleetpose.formats.tum import write_tum

WIDTH, HEIGHT, F, BASELINE_M = 320, 240, 250.0, 0.12
CX, CY = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
FIRST_NS = 1_403_636_579_763_555_584
STEP_NS = 50_000_000
_TEXELS_PER_M, _TEXTURE = 60, 1024
_WALLS = (  # normal and distance n p = d, and the two axes of its texture
    ((0.0, 0.0, 1.0), 3.0, (0, 1)),
    ((1.0, 0.0, 0.0), 1.3, (2, 1)),
    ((-1.0, 0.0, 0.0), 1.1, (2, 1)),
    ((0.0, 1.0, 0.0), 0.9, (0, 2)),
    ((0.0, -1.0, 0.0), 1.2, (0, 2)),
)


def walk(count: int) -> list[np.ndarray]:
    """T_world_camera: there and back with a slow turn, so that its halves see the same."""
    poses = []
    for t in np.linspace(-1, 1, count):
        yaw = 0.12 * np.sin(2 * t)
        q = np.array([np.cos(yaw / 2), 0.0, np.sin(yaw / 2), 0.0])
        poses.append(pose_of(q, np.array([0.25 * t * t, 0.05 * t, 0.2 * t * t])))
    return poses


def rendered(T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) grey image and (H, W) depth, m, of a room of textured walls."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = np.stack(((u - CX) / F, (v - CY) / F, np.ones(u.shape)), axis=-1)
    R, t = T_world_camera[:3, :3], T_world_camera[:3, 3]
    ways = rays @ R.T
    image, depth = np.zeros((HEIGHT, WIDTH), np.uint8), np.full((HEIGHT, WIDTH), np.inf)
    for k, (normal, d, axes) in enumerate(_WALLS):
        n = np.array(normal)
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (d - n @ t) / (ways @ n)
        near = (z > 0) & (z < depth)
        at = (t + np.where(near, z, 0.0)[..., None] * ways)[..., axes] * _TEXELS_PER_M
        at = ((at + _TEXTURE / 2) % (_TEXTURE - 1)).astype(np.float32)
        seen = cv2.remap(_texture(k), at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        image[near], depth[near] = seen[near], z[near]
    return image, depth


@lru_cache
def _texture(seed: int) -> np.ndarray:
    """Blobs of all sizes, so that there are keypoints at each."""
    rng = np.random.default_rng(seed)
    layers = [
        cv2.resize(
            rng.normal(0, s, (_TEXTURE // s,) * 2), (_TEXTURE,) * 2, interpolation=cv2.INTER_CUBIC
        )
        for s in (2, 4, 8, 16)
    ]
    total = np.sum(layers, axis=0)
    return np.clip(128 + 45 * total / total.std(), 0, 255).astype(np.uint8)


def _right_of(T_world_camera: np.ndarray) -> np.ndarray:
    shift = np.eye(4)
    shift[0, 3] = BASELINE_M
    return T_world_camera @ shift


def _write(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)


def _depth(depth: np.ndarray, steps_per_m: float) -> np.ndarray:
    return np.rint(depth * steps_per_m).astype(np.uint16)


def euroc(data: Path, poses: Sequence[np.ndarray]) -> str:
    """The camera sits crooked on the body, as EuRoC's does."""
    T_body_camera = pose_of(np.array([0.7, 0.1, -0.2, 0.7]), np.array([-0.02, -0.06, 0.01]))
    T_body_right = _right_of(T_body_camera)
    folder, rows = data / "MH_01" / "mav0", []
    for k, T in enumerate(poses):
        stamp_ns = FIRST_NS + k * STEP_NS
        _write(folder / f"cam0/data/{stamp_ns}.png", rendered(T)[0])
        _write(folder / f"cam1/data/{stamp_ns}.png", rendered(_right_of(T))[0])
        body = T @ np.linalg.inv(T_body_camera)
        numbers = [*body[:3, 3], *quat_wxyz(body[:3, :3]), *np.zeros(9)]
        rows.append(f"{stamp_ns + 2_000_000}," + ",".join(map(str, numbers)))  # 2 ms later
    for eye, T in (("cam0", T_body_camera), ("cam1", T_body_right)):
        (folder / eye / "sensor.yaml").write_text(
            f"sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {T.ravel().tolist()}\n"
            f"rate_hz: 20\nresolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\n"
            f"intrinsics: [{F}, {F}, {CX}, {CY}]\n"
            "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
        )
    truth = folder / "state_groundtruth_estimate0" / "data.csv"
    truth.parent.mkdir()
    truth.write_text("\n".join(("#timestamp, p_RS_R_x [m], ...", *rows, "")))
    return "MH_01"


def kitti(data: Path, poses: Sequence[np.ndarray]) -> str:
    folder = data / "sequences" / "00"
    for k, T in enumerate(poses):
        _write(folder / f"image_0/{k:06d}.png", rendered(T)[0])
        _write(folder / f"image_1/{k:06d}.png", rendered(_right_of(T))[0])
    for_eyes = [(0, 0.0), (1, -F * BASELINE_M)]
    (folder / "calib.txt").write_text(
        "".join(f"P{k}: {F} 0 {CX} {x} 0 {F} {CY} 0 0 0 1 0\n" for k, x in for_eyes)
    )
    write_times(folder / "times.txt", np.arange(len(poses)) * STEP_NS)
    (data / "poses").mkdir()
    write_kitti(data / "poses" / "00.txt", np.array(poses))
    return "00"


def tum(data: Path, poses: Sequence[np.ndarray]) -> str:
    folder, lists = data / "fr1", {"rgb": "# colour\n", "depth": "# depth\n"}
    for k, T in enumerate(poses):
        seconds = f"{1305031102 + k * 0.05:.4f}"
        image, depth = rendered(T)
        _write(folder / f"rgb/{seconds}.png", image)
        _write(folder / f"depth/{seconds}.png", _depth(depth, 5000))
        for name in lists:
            lists[name] += f"{seconds} {name}/{seconds}.png\n"
    for name, text in lists.items():
        (folder / f"{name}.txt").write_text(text)
    (folder / "camera-intrinsics.txt").write_text(f"{F} 0 {CX}\n0 {F} {CY}\n0 0 1\n")
    stamps_ns = 1305031102_001_000_000 + np.arange(len(poses)) * STEP_NS  # 1 ms later
    write_tum(folder / "groundtruth.txt", stamps_ns, np.array(poses))
    return "fr1"


def seven_scenes(data: Path, poses: Sequence[np.ndarray]) -> str:
    folder = data / "seq-01"
    for k, T in enumerate(poses):
        image, depth = rendered(T)
        _write(folder / f"frame-{k:06d}.color.png", image)
        _write(folder / f"frame-{k:06d}.depth.png", _depth(depth, 1000))
        np.savetxt(folder / f"frame-{k:06d}.pose.txt", T)
    (folder / "camera-intrinsics.txt").write_text(f"{F} 0 {CX}\n0 {F} {CY}\n0 0 1\n")
    return "seq-01"


def replica(data: Path, poses: Sequence[np.ndarray]) -> str:
    folder = data / "office_0_part1"
    for k, T in enumerate(poses):
        image, depth = rendered(T)
        _write(folder / f"results/frame{k:06d}.jpg", image)
        _write(folder / f"results/depth{k:06d}.png", _depth(depth, 6553.5))
    np.savetxt(folder / "traj.txt", np.array(poses).reshape(-1, 16))
    (data / "cam_params.json").write_text(
        f'{{"camera": {{"w": {WIDTH}, "h": {HEIGHT}, "fx": {F}, "fy": {F}, "cx": {CX}, '
        f'"cy": {CY}, "scale": 6553.5}}}}'
    )
    return "office_0_part1"


MAKERS: dict[str, Callable[[Path, Sequence[np.ndarray]], str]] = {
    "euroc": euroc,
    "kitti": kitti,
    "tum": tum,
    "7scenes": seven_scenes,
    "replica": replica,
}
