"""`pose-eval synth`: a synthetic world as a folder of posed views: robots on a regular ring in the
town square, or at the places of a plan that fools.

The folder has the form of recorded posed views, so that whatever runs on those runs on it. The
dense clouds come from each robot's own stereo rig by the project's own matching.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.clicks.truth import DEPTH_FOLDER
from fleetpose.evaluation.bench.working import bench_of
from fleetpose.evaluation.data.posed_views import camera_entry
from fleetpose.evaluation.data.rgbd import DEPTH_UNIT_M
from fleetpose.evaluation.metrics.geometry import Floats, inverse, transform
from fleetpose.evaluation.options.fleets import SynthOptions
from fleetpose.evaluation.report.output import output_folder
from fleetpose.evaluation.simulate.world import PLANS, PlanWorld, RingWorld, World
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.base import DisparityImage, Frame
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher

DENSE_POINTS = 20_000
NOISY_PIXEL_SIGMA_PX = 0.7
NOISY_DISPARITY_SIGMA_PX = 0.5
NOISY_BASELINE_SHARE = 0.05
_STEREO_FOLDERS = {"dense": "stereo_dense", "sparse": "stereo_pair_sparse"}
_RING_ROBOTS = (8, 72)
_FARTHEST_M = 65.0
_CORNERS_IN_ALL, _CORNERS_PER_VIEW = 24_000, (300, 2500)
_CORNER_DISTANCE_PX = 4
_SAME_DEPTH = 0.02  # share of z: a point is seen if the surface there is as near as this
_MATCH_RATIO, _MATCH_ROW_PX, _MIN_DISPARITY_PX = 0.8, 1.0, 2.0

_RING = """Made by `pose-eval synth --robots {robots} --seed {seed}`: a rendered town square, {robots}
robots on a ring of {radius_m:g} m around its middle, {separation_deg:g} deg apart, headings up to 3 deg off.
ring_angle_deg: azimuth of the robot.
"""  # noqa: E501
_PLAN = """Made by `pose-eval synth --world {plan} --unique {unique} --robots {robots} --seed
{seed}`: a rendered place of alike parts, {unique} unique things in it, robots by chance.
"""
_SOURCE = """cameras.json: x_cam = R_world_to_cam X_world + t_world_to_cam, exact; OpenCV axes; metres;
integer pixel = pixel centre.
images/: left eye, 2x2 samples per pixel, noise of 1.5 grey levels, exposures differ by some %.
depth/: the renderer's exact depth of every pixel, 16-bit PNG, millimetres, 0 in the sky.
sparse/: corners of all images, placed by the renderer's exact depth, in every view that sees them
(track_id in common, exact pixels and points: identical in all views); alike places have other ids.
sparse_noisy/: the same as a rig with a baseline of 5 % of the median depth would measure them:
Gaussian noise of {pixel_px:g} px in the image, {disparity_px:g} px of disparity (sigma_z, metres), anew per view.
stereo_dense/: semi-global matching of the robot's own two eyes, {baseline_m:g} m apart, each with its
own noise; at most {dense} points, by chance. No view is another's partner.
stereo_pair_sparse/: SIFT matches between the same two eyes, on a row to {row_px:g} px, ratio {ratio:g}.
"""  # noqa: E501


@dataclass(frozen=True)
class _Seen:
    """What the first look at a view leaves for the second: its camera and points on surfaces.

    Attributes:
        corners: (N, 3) corners of its image, world, metres.
        dense, sparse: points of its two stereo clouds.
    """

    camera: dict[str, Any]
    corners: Floats
    dense: int
    sparse: int
    baseline_m: float


def run(options: SynthOptions, out: Path) -> None:
    """Writes the folder.

    Raises:
        FleetPoseError: it cannot be made, or holds views already.
    """
    if (out / "cameras.json").exists():
        raise FleetPoseError(f"--out {out} holds posed views already; name a new folder")
    check(options)
    robots = range(options.robots)
    for kind in ("images", DEPTH_FOLDER, "sparse", "sparse_noisy", *_STEREO_FOLDERS.values()):
        output_folder(out / kind)
    with bench_of(options.workers) as bench:
        jobs = [(k, (_look, out, options, k)) for k in robots]
        seen: dict[int, _Seen] = bench.by_label("views", jobs)
        world_points = np.concatenate([seen[k].corners for k in robots])
        jobs = [(k, (_visible_from, options, k, world_points)) for k in robots]
        visible: dict[int, npt.NDArray[np.int64]] = bench.by_label("points", jobs)
    lengths = np.bincount(np.concatenate(list(visible.values())), minlength=len(world_points))
    for k in robots:
        ids = visible[k][lengths[visible[k]] >= 2]
        _write_tracks(out, seen[k].camera, ids, world_points[ids], lengths[ids], (options.seed, k))
    _write_cameras(out, [seen[k] for k in robots], options)


def check(options: SynthOptions) -> None:
    """Says early what cannot be.

    Raises:
        FleetPoseError: this cannot.
    """
    few, many = _RING_ROBOTS
    if options.plan is not None and options.plan not in PLANS:
        raise FleetPoseError(f"--world {options.plan}: there are {', '.join(sorted(PLANS))}")
    if options.plan is None and options.unique:
        raise FleetPoseError(f"--unique {options.unique}: name a plan with --world")
    if options.plan is None and not few <= options.robots <= many:
        raise FleetPoseError(f"--robots {options.robots}: a ring has {few} to {many}")


def _look(out: Path, options: SynthOptions, k: int) -> _Seen:
    """Writes one view's image and stereo clouds; runs in a worker."""
    world, matcher = _world(options)
    shot = world.shoot(k)
    frame = matcher.frame(shot.left, shot.right, 0)
    T_world_camera = shot.T_world_robot @ frame.model.T_robot_camera
    camera = _camera(k, frame, T_world_camera, options.plan is None)
    cv2.imwrite(str(out / "images" / camera["name"]), frame.image)
    rng = np.random.default_rng((options.seed, k, 1))
    dense = _dense(frame, rng)
    sparse = _matched(frame, matcher.rectifier.right(shot.right))
    for kind, (uv, z) in (("stereo_dense", dense), ("stereo_pair_sparse", sparse)):
        _write_cloud(out / kind, camera, frame.image, uv, _lifted(uv, z, frame.model.K))
    depth = world.scene.depth(T_world_camera, frame.model.K, (camera["width"], camera["height"]))
    _write_depth(out / DEPTH_FOLDER / camera["name"], depth)
    corners = _corners(frame.image, depth, _per_view(options.robots))
    points = transform(T_world_camera, _lifted(*corners, frame.model.K))
    baseline_m = matcher.rectifier.baseline_m
    return _Seen(camera, points, len(dense[0]), len(sparse[0]), baseline_m)


def _visible_from(options: SynthOptions, k: int, points: Floats) -> npt.NDArray[np.int64]:
    """Which world points (N, 3) a robot's camera sees; runs in a worker."""
    world, matcher = _world(options)
    model = matcher.model
    T_world_camera = world.T_world_robot(k) @ model.T_robot_camera
    size = (model.width, model.height)
    xyz = transform(inverse(T_world_camera), points)
    ahead = np.flatnonzero(xyz[:, 2] > 0.1)
    uv = _projected(xyz[ahead], model.K)
    inside = ((uv >= 0) & (uv <= np.subtract(size, 1))).all(axis=1)
    ahead, (columns, rows) = ahead[inside], np.rint(uv[inside]).astype(int).T
    surface = world.scene.depth(T_world_camera, model.K, size)[rows, columns]
    return ahead[np.abs(surface - xyz[ahead, 2]) < _SAME_DEPTH * xyz[ahead, 2]]


@lru_cache(maxsize=1)
def _world(options: SynthOptions) -> tuple[World, StereoMatcher]:
    world = (
        RingWorld(options.robots, 360.0 / options.robots, seed=options.seed)
        if options.plan is None
        else PlanWorld(options.plan, options.robots, options.unique, options.seed)
    )
    return world, StereoMatcher(world.rig)


def _camera(k: int, frame: Frame, T_world_camera: Floats, on_ring: bool) -> dict[str, Any]:
    T_camera_world = inverse(T_world_camera)
    x, y = T_world_camera[:2, 3]
    ring = {"ring_angle_deg": float(np.degrees(np.arctan2(y, x)) % 360.0)} if on_ring else {}
    size = (frame.model.width, frame.model.height)
    entry = camera_entry(f"view{k:03d}.png", size, frame.model.K, T_camera_world)
    return {**entry, "camera_center_world": T_world_camera[:3, 3].tolist(), **ring}


def _dense(frame: Frame, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and depths (N,) of the disparities that the robot's matcher found."""
    assert isinstance(frame.ranges, DisparityImage)
    disparity = frame.ranges.disparity_px
    rows, columns = np.nonzero(np.isfinite(disparity))
    if len(rows) > DENSE_POINTS:
        some = np.sort(rng.choice(len(rows), DENSE_POINTS, replace=False))
        rows, columns = rows[some], columns[some]
    uv = np.column_stack((columns, rows)).astype(np.float64)
    return uv, frame.ranges.focal_baseline_px_m / disparity[rows, columns].astype(np.float64)


def _matched(frame: Frame, right: npt.NDArray[np.uint8]) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and depths (N,) of SIFT matches between the two rectified eyes."""
    assert isinstance(frame.ranges, DisparityImage)
    sift: Any = cv2.SIFT_create()  # type: ignore[attr-defined]
    (left_points, left), (right_points, other) = (
        sift.detectAndCompute(image, None) for image in (frame.image, right)
    )
    if min(len(left_points), len(right_points)) < 2:
        return np.zeros((0, 2)), np.zeros(0)  # an eye before a bare wall
    matches = cv2.BFMatcher(cv2.NORM_L2).knnMatch(left, other, k=2)
    clear = [m for m, n in matches if m.distance < _MATCH_RATIO * n.distance]
    uv = np.array([left_points[m.queryIdx].pt for m in clear]).reshape(-1, 2)
    uv_right = np.array([right_points[m.trainIdx].pt for m in clear]).reshape(-1, 2)
    shift = uv - uv_right
    kept = (np.abs(shift[:, 1]) < _MATCH_ROW_PX) & (shift[:, 0] > _MIN_DISPARITY_PX)
    return uv[kept], frame.ranges.focal_baseline_px_m / shift[kept, 0]


def _corners(
    image: npt.NDArray[np.uint8], depth: npt.NDArray[np.float32], count: int
) -> tuple[Floats, Floats]:
    """Pixels (N, 2) of corners of an image, and the exact depths (N,) there."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    found = cv2.goodFeaturesToTrack(grey, count, 0.005, _CORNER_DISTANCE_PX)
    uv = np.rint(np.asarray(found, np.float64).reshape(-1, 2))
    z = depth[uv[:, 1].astype(int), uv[:, 0].astype(int)].astype(np.float64)
    return uv[np.isfinite(z)], z[np.isfinite(z)]


def _write_depth(path: Path, depth: npt.NDArray[np.float32]) -> None:
    """Depths beyond what 16 bits of millimetres hold are left out, as in the sky."""
    there = np.isfinite(depth) & (depth < _FARTHEST_M)
    raw = np.where(there, np.rint(np.where(there, depth, 0.0) / DEPTH_UNIT_M), 0)
    cv2.imwrite(str(path), raw.astype(np.uint16))


def _per_view(robots: int) -> int:
    """Corners to take from one image: a point is seen by the more robots the more there are."""
    fewest, most = _CORNERS_PER_VIEW
    return int(np.clip(_CORNERS_IN_ALL // robots, fewest, most))


def _write_tracks(
    out: Path,
    camera: Mapping[str, Any],
    ids: npt.NDArray[np.int64],
    points: Floats,
    lengths: npt.NDArray[np.int64],
    seed: tuple[int, int],
) -> None:
    """Writes a view's copy of the common points, exact and with noise of its own."""
    K = np.array(camera["K"])
    R, t = np.array(camera["R_world_to_cam"]), np.array(camera["t_world_to_cam"])
    xyz = points @ R.T + t
    uv, z = _projected(xyz, K), xyz[:, 2]
    image = cv2.imread(str(out / "images" / camera["name"]))
    assert image is not None
    _write_cloud(out / "sparse", camera, image, uv, xyz, track_id=ids, track_len=lengths)
    rng = np.random.default_rng((*seed, 2))
    baseline_m = NOISY_BASELINE_SHARE * float(np.median(z))
    sigma_z = (z**2 / (K[0, 0] * baseline_m) * NOISY_DISPARITY_SIGMA_PX).astype(np.float32)
    noisy_uv = uv + rng.normal(0.0, NOISY_PIXEL_SIGMA_PX, uv.shape)
    noisy_z = np.maximum(z + rng.normal(0.0, sigma_z), 0.1 * z)
    xyz = _lifted(noisy_uv, noisy_z, K)
    noisy = out / "sparse_noisy"
    _write_cloud(noisy, camera, image, noisy_uv, xyz, track_id=ids, sigma_z=sigma_z)


def _write_cloud(
    folder: Path,
    camera: Mapping[str, Any],
    image: npt.NDArray[Any],
    uv: Floats,
    xyz: Floats,
    **more: npt.NDArray[Any],
) -> None:
    limit = np.array((camera["width"] - 1, camera["height"] - 1))
    columns, rows = np.clip(np.rint(uv), 0, limit).astype(int).T
    arrays: dict[str, Any] = {
        "uv": np.float32(uv),
        "xyz_cam": np.float32(xyz),
        "rgb": image[rows, columns, ::-1],
        **more,
    }
    np.savez_compressed(folder / Path(camera["name"]).with_suffix(".npz").name, **arrays)


def _write_cameras(out: Path, seen: Sequence[_Seen], options: SynthOptions) -> None:
    """The stereo clouds' index files, the source, and last of all the list of cameras."""
    for kind, folder in _STEREO_FOLDERS.items():
        index = {
            one.camera["name"]: {
                "partner": None,
                "baseline_m": one.baseline_m,
                "n_points": getattr(one, kind),
            }
            for one in seen
        }
        (out / folder / "index.json").write_text(json.dumps(index, indent=1) + "\n")
    text = _SOURCE.format(
        pixel_px=NOISY_PIXEL_SIGMA_PX,
        disparity_px=NOISY_DISPARITY_SIGMA_PX,
        baseline_m=seen[0].baseline_m,
        dense=DENSE_POINTS,
        row_px=_MATCH_ROW_PX,
        ratio=_MATCH_RATIO,
    )
    made = _RING if options.plan is None else _PLAN
    radius_m = float(np.hypot(*seen[0].camera["camera_center_world"][:2]))
    ring = {"radius_m": radius_m, "separation_deg": 360.0 / options.robots}
    (out / "SOURCE.txt").write_text(made.format(**asdict(options), **ring) + text)
    convention = "x_cam = R X_world + t; OpenCV axes; pixel = K x_cam / z; metres"
    cameras = {"convention": convention, "cameras": [one.camera for one in seen]}
    (out / "cameras.json").write_text(json.dumps(cameras, indent=1) + "\n")


def _projected(xyz: Floats, K: Floats) -> Floats:
    """Pixels (N, 2) of points (N, 3) of a camera."""
    return (xyz @ K.T)[:, :2] / xyz[:, 2:]


def _lifted(uv: Floats, z: Floats, K: Floats) -> Floats:
    """Points (N, 3) of a camera from pixels (N, 2) and depths (N,)."""
    return np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(K).T * z[:, None]
