"""Covariances over restarts: what is known of made-up errors is found again; a live run."""

import json
from dataclasses import replace

import numpy as np
import pytest

from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.fleet_scoring import PoseNow, score_sample
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.system.restarts import RestartsOptions, run, views_of
from fleetpose.evaluation.system.restarts_report import scored, summarize, write_results
from fleetpose.pose_server.geometry.se3 import retract
from fleetpose.protocol.errors import DataFolderError
from tests.evaluation.makers import write_posed_views, write_rgbd

LIMITS = Limits(0.2, 2.0, 0.5, 5.0)
T_WORLD_ANCHOR = retract(np.eye(4), np.array([0.1, 0.2, 0.3, 4.0, 5.0, 6.0]))


def rows_of(restarts, robots, stated=1.0, seed=0, reference_m=0.0):
    """Robots with errors of a known covariance, of which `stated` times as much is published; their
    true positions come with noise of their own.
    """
    limits = replace(LIMITS, reference_sigma_m=reference_m)
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(6, 6)) * 1e-2
    C = A @ A.T + 1e-5 * np.eye(6)
    L = np.linalg.cholesky(C)
    rows = []
    for restart in range(restarts):
        poses = {"r0": PoseNow(np.eye(4), np.zeros((6, 6)), "r0", True, T_WORLD_ANCHOR)}
        for k in range(1, robots):
            T_true = retract(np.eye(4), rng.normal(size=6))
            T = np.linalg.inv(retract(np.eye(4), L @ rng.normal(size=6))) @ T_true
            T_true[:3, 3] += reference_m * rng.normal(size=3)
            poses[f"r{k}"] = PoseNow(T, stated * C, "r0", True, T_WORLD_ANCHOR @ T_true)
        sample = score_sample(1.0, list(poses), poses, "r0", reference_m)
        rows += [scored(restart, row, sample, limits) for row in sample if not row.is_anchor]
    return rows


def test_right_covariances_are_found_to_be_right():
    found = summarize(rows_of(60, 6))
    assert found["poses"] == 300
    assert found["nees_per_dof_median"] == pytest.approx(5.348 / 6, rel=0.12)  # of a chi-square
    assert found["nees_rotation_per_dof_median"] == pytest.approx(2.366 / 3, rel=0.2)
    assert found["nees_translation_per_dof_median"] == pytest.approx(2.366 / 3, rel=0.2)
    assert 0.91 < found["coverage_95"] < 0.98
    assert found["nees_per_dof_median_low"] < found["nees_per_dof_median"]
    assert found["coverage_95_low"] <= found["coverage_95"] <= found["coverage_95_high"]


def test_covariances_that_are_too_small_or_too_large_are_seen():
    assert summarize(rows_of(40, 5, stated=0.1))["coverage_95"] < 0.5
    assert summarize(rows_of(40, 5, stated=10.0))["nees_per_dof_median"] < 0.2


def test_noise_of_the_reference_is_no_error_of_the_covariance():
    found = summarize(rows_of(60, 6, reference_m=0.05))
    assert found["nees_per_dof_median"] == pytest.approx(5.348 / 6, rel=0.12)
    assert found["nees_translation_per_dof_median"] == pytest.approx(2.366 / 3, rel=0.2)
    assert 0.91 < found["coverage_95"] < 0.98


def test_the_worst_set_comes_first_and_none_is_left_out(tmp_path, capsys):
    about = {"restarts": 20, "robots": 5, "reference_sigma_m": 0.0, "split": "held out"}
    sets = {"right": 1.0, "far too sure": 0.1, "careful": 10.0}
    found = [({"set": name, **about}, rows_of(20, 5, stated)) for name, stated in sets.items()]
    summary = write_results(tmp_path, found)
    assert [one["set"] for one in summary["sets"]] == ["far too sure", "right", "careful"]
    assert summary["set"] == "far too sure" and summary["coverage_95"] < 0.5
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == 1 + 3 * 20 * 4
    assert "noise" not in capsys.readouterr().out


def test_restarts_begin_at_different_places_without_partners(tmp_path):
    write_posed_views(tmp_path / "set", count=12)
    recording = open_recording(tmp_path / "set", "stereo_pair_sparse")
    options = RestartsOptions(restarts=4, robots=3)
    places = views_of(recording, options)
    assert len(set(places)) == 4
    assert all(a ^ 1 not in place for place in places for a in place)
    with pytest.raises(DataFolderError, match="fewer --restarts"):
        views_of(recording, RestartsOptions(restarts=13, robots=3))


def test_recordings_by_a_depth_camera_are_judged_against_their_own_noise(tmp_path, capsys):
    write_rgbd(tmp_path / "walk", count=3)
    write_posed_views(tmp_path / "set", count=3)
    both = (tmp_path / "set", tmp_path / "walk")
    options = RestartsOptions(both, "sparse_noisy", restarts=1, robots=2, workers=1, offline=True)
    summary = run(options, tmp_path / "out")
    noise = {one["set"]: one["reference_sigma_m"] for one in summary["sets"]}
    assert noise == {"set": 0.0, "walk": 0.05}
    assert "0.05 m noise" in capsys.readouterr().out


def test_fleets_are_started_anew(tmp_path):
    summary = run(RestartsOptions(restarts=1, robots=3, seconds=6.0), tmp_path)
    assert summary["poses"] == 2 and summary["grave_located"] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["restarts"] == 1
    assert (tmp_path / "nees.png").stat().st_size > 1000
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == 3
