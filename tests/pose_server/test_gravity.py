"""With gravity known one point and a turn give a shift, two points give a pose."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.gravity import Gravity, pose_by_gravity, shift_by_gravity
from fleetpose.pose_server.geometry.se3 import (
    exp_so3,
    inverse,
    log_so3,
    make_pose,
    rotation_angle,
    transform,
)
from tests.pose_server.point_makers import random_pose, round_the_scene, seeds, seen_by_two


def unit(rng: np.random.Generator) -> np.ndarray:
    v = rng.normal(0, 1, 3)
    return v / np.linalg.norm(v)


def known_in_both(rng: np.random.Generator, T_a_b: np.ndarray) -> Gravity:
    up_b = unit(rng)
    return Gravity(T_a_b[:3, :3] @ up_b, up_b)


@given(seeds, st.integers(2, 5))
def test_two_points_and_gravity_give_the_pose(rng, count):
    T = random_pose(rng)
    p_b, gravity = rng.normal(0, 3, (count, 3)), known_in_both(rng, T)
    level = p_b - np.outer(p_b @ gravity.up_b, gravity.up_b)
    assume(np.linalg.norm(level - level.mean(0), axis=1).max() > 0.5)  # not above each other
    found = pose_by_gravity(transform(T, p_b), p_b, gravity)
    assert np.allclose(found, T, atol=1e-6)


@given(seeds)
def test_one_point_gravity_and_a_known_turn_give_the_pose(rng):
    T = random_pose(rng)
    gravity = known_in_both(rng, T)
    yaw_rad = log_so3(T[:3, :3] @ gravity.level().T) @ gravity.up_a
    p_b = rng.normal(0, 3, (1, 3))
    assert np.allclose(shift_by_gravity(transform(T, p_b), p_b, gravity, yaw_rad), T, atol=1e-6)


@given(seeds, st.floats(-3.1, 3.1))
def test_up_is_always_brought_to_up(rng, yaw_rad):
    up = unit(rng)
    for other in (unit(rng), up, -up):
        R = Gravity(up, other).turned(yaw_rad)
        assert np.allclose(R @ other, up, atol=1e-9)
        assert np.allclose(R @ R.T, np.eye(3)) and np.linalg.det(R) > 0


@given(seeds)
def test_moving_a_frame_with_its_gravity_moves_the_pose(rng):
    T, A = random_pose(rng), random_pose(rng)
    p_b = rng.normal(0, 3, (3, 3))
    p_a = transform(T, p_b) + rng.normal(0, 0.05, (3, 3))
    gravity = known_in_both(rng, T)
    moved = Gravity(A[:3, :3] @ gravity.up_a, gravity.up_b)
    here = pose_by_gravity(p_a, p_b, gravity)
    assert np.allclose(pose_by_gravity(transform(A, p_a), p_b, moved), A @ here, atol=1e-6)


def test_points_above_each_other_leave_the_turn_open():
    gravity = Gravity(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.0, 1.0]))
    p = np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 3.0]])
    with pytest.raises(DegenerateGeometryError, match="above each other"):
        pose_by_gravity(p, p, gravity)
    with pytest.raises(DegenerateGeometryError, match="above each other"):
        pose_by_gravity(p[:1], p[:1], gravity)


@pytest.mark.parametrize("up", [np.zeros(3), np.full(3, np.nan), np.array([0.0, 0.0, 9.81])])
def test_up_is_a_unit_vector(up):
    with pytest.raises(DegenerateGeometryError, match="length"):
        Gravity(up, np.array([0.0, 0.0, 1.0]))


def test_refined_with_gravity_two_points_know_how_good_their_pose_is():
    rng = np.random.default_rng(0)
    nees, turns_deg = [], []
    for _ in range(200):
        T = round_the_scene(rng)
        pairs = seen_by_two(rng, T, 2)
        up_b = np.array([0.0, -1.0, 0.0])
        tilt = exp_so3(rng.normal(0, 0.02, 3))
        gravity = Gravity(tilt @ T[:3, :3] @ up_b, up_b, 0.02)
        start = pose_by_gravity(pairs.p_a, pairs.p_b, gravity)
        found, covariance = pairs.refined(start, gravity)
        E = T @ inverse(found)
        xi = np.concatenate((log_so3(E[:3, :3]), E[:3, 3]))
        nees.append(xi @ np.linalg.solve(covariance, xi) / 6)
        turns_deg.append(np.degrees(rotation_angle(E[:3, :3])))
    assert np.median(turns_deg) < 6
    assert 0.7 < np.mean(nees) < 1.4


def test_without_gravity_two_points_are_refused():
    pairs = seen_by_two(np.random.default_rng(1), make_pose(np.eye(3), np.ones(3)), 2)
    with pytest.raises(DegenerateGeometryError, match="do not determine a pose"):
        pairs.refined(np.eye(4))
