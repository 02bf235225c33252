"""Covariances over restarts: what is known of made-up errors is found again; a live run."""

import json

import numpy as np
import pytest

from evaluation.fleet_scoring import PoseNow, score_sample
from evaluation.restarts import RestartsOptions, run, scored, summarize
from evaluation.scoring import Limits
from pose_server.geometry.se3 import retract

LIMITS = Limits(0.2, 2.0, 0.5, 5.0)
T_WORLD_ANCHOR = retract(np.eye(4), np.array([0.1, 0.2, 0.3, 4.0, 5.0, 6.0]))


def rows_of(restarts, robots, stated=1.0, seed=0):
    """Robots with errors of a known covariance, of which `stated` times as much is published."""
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
            poses[f"r{k}"] = PoseNow(T, stated * C, "r0", True, T_WORLD_ANCHOR @ T_true)
        sample = score_sample(1.0, list(poses), poses, "r0")
        rows += [scored(restart, row, sample, LIMITS) for row in sample if not row.is_anchor]
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


def test_fleets_are_started_anew(tmp_path):
    summary = run(RestartsOptions(restarts=2, robots=3, seconds=6.0), tmp_path)
    assert summary["poses"] == 4 and summary["grave_located"] == 0
    assert json.loads((tmp_path / "summary.json").read_text())["restarts"] == 2
    assert (tmp_path / "nees.png").stat().st_size > 1000
    assert len((tmp_path / "poses.csv").read_text().splitlines()) == 5
