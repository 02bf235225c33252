"""What is ok and what is grave follows the definitions."""

import numpy as np
import pytest

from fleetpose.evaluation.metrics.geometry import inverse, rigid, transform
from fleetpose.evaluation.metrics.scoring import (
    CHI2_6_95,
    Limits,
    OverlapCloud,
    aligned_errors_m,
    nees,
    optical_angle_deg,
    overlap,
    percentile,
    position_error_m,
    precision_recall,
    rotation_error_deg,
    share,
    weakest_sigma_m,
)
from tests.evaluation.makers import pose, random_pose, rotation


def test_ok_is_below_2_percent_of_the_median_depth_and_2_deg():
    limits = Limits.of(10.0, rgbd=False)
    assert limits.ok(0.199, 1.99)
    assert not limits.ok(0.2, 0.0)
    assert not limits.ok(0.0, 2.0)


def test_grave_is_above_5_percent_or_5_deg():
    limits = Limits.of(10.0, rgbd=False)
    assert limits.grave(0.501, 0.0)
    assert limits.grave(0.0, 5.01)
    assert not limits.grave(0.5, 5.0)


def test_grave_on_rgbd_is_above_30_cm_or_15_deg():
    limits = Limits.of(2.0, rgbd=True)
    assert not limits.grave(0.3, 15.0)
    assert limits.grave(0.301, 0.0)
    assert limits.grave(0.0, 15.1)
    assert not limits.ok(0.05, 0.0)
    assert limits.ok(0.039, 1.9)


@pytest.mark.parametrize("angle_deg", [1e-6, 0.5, 30.0, 179.0, 180.0])
def test_rotation_error_is_the_angle_between(angle_deg):
    T = random_pose(np.random.default_rng(1))
    turned = T @ rigid(rotation((0.6, 0.0, 0.8), angle_deg), np.zeros(3))
    assert rotation_error_deg(T, turned) == pytest.approx(angle_deg, rel=1e-4)


def test_position_error_is_the_distance_of_translations():
    assert position_error_m(pose(0, (1, 2, 3)), pose(50, (1, 2, 5))) == pytest.approx(2.0)


def test_angle_is_between_optical_axes_whatever_the_roll():
    rolled = rigid(rotation((0, 1, 0), 35.0) @ rotation((0, 0, 1), 90.0), np.ones(3))
    assert optical_angle_deg(np.eye(4), rolled) == pytest.approx(35.0)
    assert optical_angle_deg(np.eye(4), pose(180.0)) == pytest.approx(180.0)


def test_overlap_is_the_mean_of_both_directions():
    rng = np.random.default_rng(2)
    both = rng.uniform((-1, -1, 2), (1, 1, 2.01), (4000, 3))
    far = rng.uniform((9, -1, 2), (11, 1, 2.01), (4000, 3))
    T_i_j = random_pose(rng)
    p_i, p_j = np.concatenate((both, far)), transform(inverse(T_i_j), both)
    rng.shuffle(p_i)
    # tolerances follow z in the own camera: keep the points of j in front of it
    near = OverlapCloud.of(p_j)
    found = overlap(OverlapCloud.of(p_i), OverlapCloud(near.asked * [1, 1, 1], near.tree), T_i_j)
    assert found == pytest.approx(0.75, abs=0.03)


def test_overlap_reaches_5_cm_and_2_percent_of_z_and_no_further():
    grid = np.stack(np.meshgrid(np.arange(-1, 1, 0.5), np.arange(-1, 1, 0.5)), -1).reshape(-1, 2)
    wall = np.column_stack((grid, np.full(len(grid), 5.0)))
    cloud = OverlapCloud.of(wall)
    assert overlap(cloud, cloud, pose(0, (0.0, 0.0, 0.149))) == 1.0
    assert overlap(cloud, cloud, pose(0, (0.0, 0.0, 0.151))) == 0.0


def test_nees_is_6_on_average_for_errors_drawn_from_the_covariance():
    import scipy.linalg

    from tests.evaluation.test_geometry import hat

    rng = np.random.default_rng(3)
    A = rng.normal(size=(6, 6)) * 0.01
    covariance = A @ A.T
    T = random_pose(rng)
    twists = rng.multivariate_normal(np.zeros(6), covariance, 1500)
    moved = scipy.linalg.expm(np.array([hat(xi) for xi in twists])) @ T
    values = [nees(T_true, T, covariance) for T_true in moved]
    assert np.mean(values) == pytest.approx(6.0, rel=0.05)
    assert np.mean(np.array(values) <= CHI2_6_95) == pytest.approx(0.95, abs=0.015)


def test_nees_of_a_singular_covariance_is_nan():
    assert np.isnan(nees(np.eye(4), np.eye(4), np.zeros((6, 6))))


def test_aligned_errors_forgive_the_gauge_but_not_the_shape():
    rng = np.random.default_rng(4)
    true = rng.normal(size=(5, 3))
    moved = transform(random_pose(rng), true)
    assert aligned_errors_m(true, moved) == pytest.approx(np.zeros(5), abs=1e-9)
    moved[0] += (0.3, 0.0, 0.0)
    assert 0.1 < aligned_errors_m(true, moved).max() < 0.3


def test_weakest_sigma_is_that_of_the_position_only():
    covariance = np.diag([9.0, 9.0, 9.0, 0.01, 0.04, 0.01])
    assert weakest_sigma_m(covariance) == pytest.approx(0.2)
    assert weakest_sigma_m(None) == np.inf


def test_precision_and_recall_as_answers_are_accepted_from_the_surest_down():
    recall, precision = precision_recall(
        [(4.0,), (4.0,), (3.0,), (2.0,)], [True, True, False, True]
    )
    assert recall == pytest.approx([2 / 3, 2 / 3, 1.0])
    assert precision == pytest.approx([1.0, 2 / 3, 3 / 4])


def test_nothing_to_measure_is_none():
    assert share([]) is None
    assert share([True, False]) == 0.5
    assert percentile([], 95) is None
    assert percentile([1.0, 3.0], 50) == 2.0
