"""Published poses are scored against the truth with the anchor as gauge."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.evaluation.metrics.fleet_scoring import (
    PoseNow,
    SampleRow,
    score_sample,
    summarize_poses,
)
from fleetpose.evaluation.metrics.geometry import inverse
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.system.fleet_report import latencies
from fleetpose.evaluation.system.observer import first_time_located
from tests.evaluation.makers import pose, random_pose

NAMES = ("a", "b", "c")
LIMITS = Limits.of(10.0, rgbd=False)


def now(T_fleet_robot, T_world_robot, component="a", located=True):
    return PoseNow(T_fleet_robot, 1e-4 * np.eye(6), component, located, T_world_robot)


def fleet(shift_b=(0.0, 0.0, 0.0), **more):
    """Three robots whose estimates are right but for a shift of b; the fleet frame is anywhere."""
    rng = np.random.default_rng(1)
    T_fleet_world = random_pose(rng)
    true = {name: random_pose(rng) for name in NAMES}
    found = {name: T_fleet_world @ T for name, T in true.items()}
    found["b"] = pose(0.0, shift_b) @ found["b"]
    return {name: now(found[name], true[name], **more) for name in NAMES}


def test_a_right_fleet_has_no_errors_in_whatever_frame():
    for row in score_sample(1.0, NAMES, fleet(), "a"):
        assert row.position_error_m == pytest.approx(0.0, abs=1e-9)
        assert row.rotation_error_deg == pytest.approx(0.0, abs=1e-5)
        assert row.located


def test_errors_are_relative_to_the_anchor():
    by_name = {row.robot: row for row in score_sample(1.0, NAMES, fleet((0.3, 0.0, 0.4)), "a")}
    assert by_name["b"].position_error_m == pytest.approx(0.5)
    assert by_name["c"].position_error_m == pytest.approx(0.0, abs=1e-9)
    assert by_name["b"].nees == pytest.approx(0.25 / 1e-4, rel=1e-6)
    assert by_name["a"].is_anchor
    assert by_name["a"].nees is None


def test_another_component_than_the_anchors_is_not_located_and_has_no_error():
    poses = fleet()
    poses["c"] = now(poses["c"].T_fleet_robot, poses["c"].T_world_robot, component="c-0")
    rows = {row.robot: row for row in score_sample(1.0, NAMES, poses, "a")}
    assert not rows["c"].located
    assert rows["c"].position_error_m is None


def test_a_robot_without_a_pose_is_in_the_sample_and_not_located():
    poses = fleet()
    del poses["c"]
    rows = {row.robot: row for row in score_sample(1.0, NAMES, poses, "a")}
    assert not rows["c"].located
    assert rows["c"].T_fleet_robot is None


def test_located_means_in_90_percent_of_the_samples():
    rows = []
    for k in range(20):
        poses = fleet()
        if k < 2:
            poses["b"] = now(poses["b"].T_fleet_robot, poses["b"].T_world_robot, located=False)
        if k < 3:
            del poses["c"]
        rows += score_sample(float(k), NAMES, poses, "a")
    summary = summarize_poses(rows, LIMITS)
    assert summary["robots"] == 3
    assert summary["located"] == 2
    assert summary["samples"] == 20


def test_the_mean_leaves_the_anchor_out_and_the_fit_forgives_the_gauge():
    rows = score_sample(1.0, NAMES, fleet((0.6, 0.0, 0.0)), "a")
    summary = summarize_poses(rows, LIMITS)
    assert summary["position_error_mean_m"] == pytest.approx(0.3)
    assert summary["position_error_max_m"] == pytest.approx(0.6)
    assert 0.0 < summary["position_error_aligned_m"] < 0.3
    assert summary["grave_located"] == 1


def test_grave_counts_located_samples_only():
    poses = fleet((5.0, 0.0, 0.0), located=False)
    assert summarize_poses(score_sample(1.0, NAMES, poses, "a"), LIMITS)["grave_located"] == 0
    poses = fleet((5.0, 0.0, 0.0))
    assert summarize_poses(score_sample(1.0, NAMES, poses, "a"), LIMITS)["grave_located"] == 1


def test_a_fleet_without_any_pose_has_no_numbers():
    summary = summarize_poses(score_sample(1.0, NAMES, {}, None), LIMITS)
    assert summary["located"] == 0
    assert summary["position_error_mean_m"] is None
    assert summary["nees_per_dof"] is None
    assert summary["coverage_95"] is None


def test_calibrated_covariances_give_nees_1_and_coverage_95():
    rng = np.random.default_rng(2)
    covariance = np.diag([1e-6] * 3 + [1e-4] * 3)
    rows: list[SampleRow] = []
    for k in range(500):
        poses = fleet()
        for name in ("b", "c"):
            w = rng.normal(0, 1e-3, 3)
            T = pose(0.0, tuple(rng.normal(0, 1e-2, 3)))
            T[:3, :3] += np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
            shifted = T @ poses[name].T_fleet_robot
            poses[name] = PoseNow(shifted, covariance, "a", True, poses[name].T_world_robot)
        rows += score_sample(float(k), NAMES, poses, "a")
    summary = summarize_poses(rows, LIMITS)
    assert summary["nees_per_dof"] == pytest.approx(1.0, abs=0.1)
    assert summary["coverage_95"] == pytest.approx(0.95, abs=0.03)


def test_first_times_are_counted_from_when_all_were_up():
    counts = [(10.0, 0), (12.0, 1), (15.0, 2), (16.0, 1), (19.0, 3)]
    assert first_time_located(counts, 2, 11.0) == pytest.approx(4.0)
    assert first_time_located(counts, 3, 11.0) == pytest.approx(8.0)
    assert first_time_located(counts, 2, 18.0) == 0.0
    assert first_time_located(counts, 4, 11.0) is None


def test_truth_is_in_the_same_frame_as_the_estimate():
    poses = fleet()
    T_fleet_world = poses["a"].T_fleet_robot @ inverse(poses["a"].T_world_robot)
    assert T_fleet_world @ poses["b"].T_world_robot == pytest.approx(poses["b"].T_fleet_robot)


def test_a_consumer_that_drops_unverified_poses_acts_on_no_grave_one_of_these():
    poses = fleet((5.0, 0.0, 0.0))
    for verified, acted in ((True, 1), (False, 0)):
        poses["b"] = replace(poses["b"], verified=verified)
        summary = summarize_poses(score_sample(1.0, NAMES, poses, "a"), LIMITS)
        assert (summary["grave_located"], summary["grave_acted"]) == (1, acted)


def test_located_right_is_a_share_of_the_samples_of_robots_that_are_seen_together():
    rows = []
    for k in range(4):
        poses = fleet((9.0, 0.0, 0.0))  # b is gravely off
        if k == 0:
            del poses["c"]
        rows += score_sample(float(k), NAMES, poses, "a")
    summary = summarize_poses(rows, LIMITS, {"b", "c"})
    assert summary["grave_located"] == 4
    assert summary["robots_seen_together"] == 2
    assert summary["located_right"] == pytest.approx(3 / 8)
    assert summarize_poses(rows, LIMITS)["located_right"] is None


def test_a_click_that_led_to_no_pose_took_for_ever():
    found = latencies([0.1] * 18 + [31.0], [45.0], [0.2], [])
    assert found["click_to_pose_ms_p50"] == pytest.approx(100.0)
    assert found["click_to_pose_ms_p95"] == float("inf")
    assert found["clicks_late"] == 2 and found["clicks_unanswered_s"] == [45.0]
    assert found["view_to_pose_ms_p95"] == pytest.approx(200.0)
    assert found["moving_view_to_pose_ms_p95"] is None
    assert latencies([], [], [], [])["click_to_pose_ms_p95"] is None
