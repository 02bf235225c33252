"""`pose-eval align` measures peers that work, on the same pairs, by the same limits."""

import csv
import json

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.bench import align_worker
from fleetpose.evaluation.bench.align import Bars, run, score
from fleetpose.evaluation.bench.align_worker import Timed, missing_peers
from fleetpose.evaluation.bench.baselines import PEERS, Peer, Sight, points_at, sift_view
from fleetpose.evaluation.metrics.geometry import inverse, transform
from fleetpose.evaluation.metrics.scoring import position_error_m, rotation_error_deg
from fleetpose.evaluation.options.recorded import AlignOptions
from tests.evaluation.makers import pose, write_posed_views


def furnished_corner(rng, count=25_000):
    """Points (N, 3) of two walls, a floor and boxes of different sizes, metres."""
    lowest = np.array([[-1.5, -1, 3], [-1.5, -1, 1.5], [-1.5, 1, 1.5]], float)
    highest = np.array([[1.5, 1, 3], [-1.5, 1, 3], [1.5, 1, 3]], float)
    for x, y, z, size in ((-1, 0.5, 2.4, 0.5), (0.2, 0.2, 2.1, 0.8), (1, -0.6, 2.7, 0.3)):
        for axis in range(3):
            low, high = np.array([x, y, z], float), np.array([x, y, z]) + size
            high[axis] = low[axis]
            lowest, highest = np.vstack((lowest, low)), np.vstack((highest, high))
    face = rng.integers(len(lowest), size=count)
    points = rng.uniform(lowest[face], highest[face])
    return points + rng.normal(scale=0.003, size=points.shape)


def painted_relief(T_world_camera):
    """What a camera sees of a painted wall 2 m away that bulges here and there."""
    paint = cv2.GaussianBlur(np.random.default_rng(2).uniform(0, 255, (1200, 1200)), (0, 0), 3)
    paint = cv2.normalize(paint, None, 0, 255, cv2.NORM_MINMAX).astype(np.float32)
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    rays = np.stack(((u - 159.5) / 300, (v - 119.5) / 300, np.ones_like(u)), -1).reshape(-1, 3)
    rays, eye = rays @ T_world_camera[:3, :3].T, T_world_camera[:3, 3]
    reach = np.full(len(rays), 2.0)
    for _ in range(30):  # walks along each ray to the wall
        at = eye + reach[:, None] * rays
        wall_z = 2.0 - 0.15 * np.sin(3 * at[:, 0]) * np.cos(4 * at[:, 1])
        reach += (wall_z - at[:, 2]) / rays[:, 2]
    at = (eye + reach[:, None] * rays).astype(np.float32)
    columns, rows = (600 + 300 * at[:, axis].reshape(u.shape) for axis in (0, 1))
    image = cv2.remap(paint, columns, rows, cv2.INTER_LINEAR).astype(np.uint8)
    points = transform(inverse(T_world_camera), at.astype(float))
    return Sight(points, np.column_stack((u.ravel(), v.ravel())), image)


def without_image(points):
    return Sight(points, np.zeros((len(points), 2)), np.zeros((8, 8), np.uint8))


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_each_peer_finds_a_known_pose(peer):
    if reason := missing_peers().get(peer.name):
        pytest.skip(reason)
    if peer.prepare is sift_view:
        T_i_j = pose(12.0, (-0.3, 0.1, 0.2))
        i, j = painted_relief(np.eye(4)), painted_relief(T_i_j)
    else:
        rng = np.random.default_rng(1)
        T_i_j = pose(20.0, (0.4, 0.1, -0.2))
        i = without_image(furnished_corner(rng))
        j = without_image(transform(inverse(T_i_j), furnished_corner(rng)))
    found = peer.align(peer.prepare(i), peer.prepare(j))
    assert position_error_m(T_i_j, found) < 0.03
    assert rotation_error_deg(T_i_j, found) < 1.0


def test_shares_are_of_all_pairs_answered_or_not():
    truth = pose(10.0, (1.0, 0.0, 0.0))
    answers = [
        Timed(truth, 10.0, 9.0, 100.0),
        Timed(truth @ pose(5.0), 20.0, 9.0, 200.0),
        Timed(pose(10.0, (2.0, 0.0, 0.0)), 30.0, 9.0, 300.0),
        Timed(None, 40.0, 9.0, 400.0),
    ]
    row = score("one", [truth] * 4, answers, Bars.of(2.0, rgbd=True))
    assert (row["recall"], row["strict_recall"]) == (0.5, 0.25)
    assert (row["pair_ms_median"], row["whole_ms_median"]) == (25.0, 250.0)


def test_every_method_is_timed_on_the_second_run_of_a_pair(tmp_path, monkeypatch):
    runs = []

    def slow_at_first(i, j):
        runs.append((i, j))
        return pose(float(len(runs)))

    one = Peer("one", lambda sight: len(sight.points), slow_at_first, {})
    monkeypatch.setattr(align_worker, "PEERS", (one,))
    sight = without_image(np.zeros((5, 3)))
    monkeypatch.setattr(align_worker, "_sight", lambda wire, scale: sight)
    timed = align_worker.align_peers(tmp_path / "i", tmp_path / "j", 1.0, ["one"])["one"]
    assert runs == [(5, 5), (5, 5)]
    assert timed.T_i_j == pytest.approx(pose(2.0))


def test_a_keypoint_has_the_depth_of_its_pixel_or_of_one_near(monkeypatch):
    uv = np.array([[10.0, 5.0], [30.0, 20.0]])
    sight = Sight(np.array([[0, 0, 1.0], [0, 0, 2.0]]), uv, np.zeros((40, 60), np.uint8))
    pixels = np.array([[10.2, 4.8], [31.9, 18.1], [33.0, 20.0], [59.0, 39.0]])
    assert points_at(sight, pixels).tolist() == [0, 1, -1, -1]


def test_posed_views_are_measured_by_grave_and_ok():
    bars = Bars.of(10.0, rgbd=False)
    assert bars == Bars(recall_m=0.5, recall_deg=5.0, strict_m=0.2, strict_deg=2.0)


@pytest.mark.parametrize("images", [True, False])
def test_every_method_meets_the_same_pairs(tmp_path, images):
    write_posed_views(tmp_path / "set", count=2)
    run(AlignOptions(tmp_path / "set", "sparse_noisy", images=images), tmp_path / "out")
    with (tmp_path / "out" / "align.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_images = ["sift_ransac_icp"] * images
    methods = ["fleetpose", *by_images, "open3d_ransac_icp", "open3d_fgr_icp", "kiss_gicp"]
    missing = missing_peers()
    assert [row["method"] for row in rows] == [name for name in methods if name not in missing]
    assert {row["pairs"] for row in rows} == {"1"}
    assert all(float(row[ms]) > 0 for row in rows for ms in ("whole_ms_median", "pair_ms_median"))
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["missing"] == missing
    assert set(summary["settings"]) == set(methods[1:])
    assert summary["voxel_m"] == pytest.approx(0.025 * summary["median_depth_m"])
