"""A fleet's map beside the truth: what poses do and what noise does are told apart."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fleetpose.evaluation.bench.mapping.command import MapOptions, run
from fleetpose.evaluation.bench.mapping.compare import compared, moved_by_poses
from fleetpose.evaluation.bench.mapping.memory import peak_memory
from fleetpose.evaluation.bench.mapping.truth import at_true_poses, true_cloud, world_from_fleet
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.pose_server.mapping.located import PlacedView
from fleetpose.pose_server.state.views import KeptView, open_view
from fleetpose.protocol.codec import pack
from tests.data import shared_data
from tests.evaluation.makers import pose, write_posed_views, write_rgbd
from tests.pose_server.scene import descriptors, view, walls


@pytest.fixture
def kept() -> KeptView:
    rng = np.random.default_rng(0)
    message = view(rng, "r1", walls(rng, 400), descriptors(rng, 400), np.eye(4))
    return open_view(pack(message), None, 0.0)


def placed(kept: KeptView, T: np.ndarray) -> PlacedView:
    return PlacedView(0, kept, T, np.zeros((3, 3)))


def test_poses_that_are_right_move_no_point_and_shifted_ones_all_by_the_shift(kept):
    T = pose(30, (1.0, 2.0, 3.0))
    off = T.copy()
    off[:3, 3] += (0.3, 0.0, 0.4)
    assert moved_by_poses([placed(kept, T)], [placed(kept, T)]).p95_m == 0.0
    shift = moved_by_poses([placed(kept, T)], [placed(kept, off)])
    assert shift.median_m == pytest.approx(0.5) and shift.p95_m == pytest.approx(0.5)


def test_accuracy_is_of_the_map_and_completeness_of_the_truth():
    grid = np.stack(np.meshgrid(*3 * [np.arange(10.0)]), axis=-1).reshape(-1, 3)
    half = grid[grid[:, 0] < 5]
    found = compared(half + np.array((0.0, 0.0, 0.1)), grid)
    assert (found.accuracy_median_m, found.accuracy_p95_m) == pytest.approx((0.1, 0.1))
    assert found.completeness_p95_m > 4.0  # half of the place is missing


def test_the_anchor_stands_where_it_truly_stands(kept, tmp_path):
    write_posed_views(tmp_path / "set", count=2)
    true = open_recording(tmp_path / "set", "sparse").usable[0]
    here = placed(kept, pose(70, (4.0, 0.0, 0.0)))
    T_world_fleet = world_from_fleet([here], {"r1": true}, "r1")
    assert np.allclose(T_world_fleet @ here.T_fleet_camera, true.T_world_camera)
    elsewhere = replace(here, T_fleet_camera=np.eye(4))
    (righted,) = at_true_poses([elsewhere], {"r1": true}, T_world_fleet)
    assert np.allclose(righted.T_fleet_camera, here.T_fleet_camera)


def test_the_truth_is_free_of_noise_where_the_recording_has_it(kept, tmp_path):
    write_posed_views(tmp_path / "set", count=2)
    noisy = open_recording(tmp_path / "set", "sparse_noisy")
    here = placed(kept, np.eye(4))
    truth = true_cloud(noisy, noisy.usable[:1], [here], {"r1": noisy.usable[0]})
    assert "without the robots' noise" in truth.what
    assert np.abs(truth.points).max() <= 0.5 + 1e-9 and len(truth.points) == 300
    write_rgbd(tmp_path / "walk", count=1)
    walk = open_recording(tmp_path / "walk")
    own = true_cloud(walk, walk.usable, [here], {"r1": walk.usable[0]})
    assert "with their noise" in own.what and len(own.points) != 300


def test_memory_at_the_peak_is_noted():
    with peak_memory() as peak:
        block = np.ones(100_000_000, np.uint8)
    del block
    assert peak.added_mb is None or peak.added_mb > 80


def test_a_fleet_on_a_real_portal_is_mapped_to_centimetres(tmp_path):
    """Three neighbours 14 m away: poses move points by far less than noise does."""
    data = shared_data("church_herzjesu")
    options = MapOptions(data, "stereo_pair_sparse", robots=3, first=4, workers=1)
    summary = run(options, tmp_path)
    assert summary["located"] == 3
    assert summary["poses"]["median_m"] < 0.05
    assert summary["map"]["accuracy_median_m"] < 0.05
    assert summary["map"]["completeness_median_m"] < 0.05
    assert json.loads((tmp_path / "summary.json").read_text())["points"] == summary["points"]
    assert (tmp_path / "map.png").exists() and (tmp_path / "map.ply").exists()
