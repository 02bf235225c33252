"""The evaluation's own geometry agrees with independent references."""

import numpy as np
import pytest
import scipy.linalg
from scipy.spatial.transform import Rotation

from fleetpose.evaluation.metrics.geometry import (
    align_points,
    inverse,
    nearest_rotation,
    quat_wxyz,
    se3_log,
    transform,
)
from tests.evaluation.makers import random_pose


def hat(xi):
    w, v = xi[:3], xi[3:]
    M = np.zeros((4, 4))
    M[:3, :3] = [[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]]
    M[:3, 3] = v
    return M


@pytest.mark.parametrize("angle_deg", [1e-8, 1e-4, 1.0, 90.0, 179.0])
def test_log_undoes_the_matrix_exponential(angle_deg):
    rng = np.random.default_rng(1)
    w = rng.normal(size=3)
    xi = np.concatenate((w / np.linalg.norm(w) * np.radians(angle_deg), rng.normal(size=3)))
    assert se3_log(scipy.linalg.expm(hat(xi))) == pytest.approx(xi, abs=1e-7)


def test_inverse_cancels():
    T = random_pose(np.random.default_rng(2))
    assert T @ inverse(T) == pytest.approx(np.eye(4), abs=1e-12)


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, 120.0, 180.0])
def test_quaternion_agrees_with_scipy(angle_deg):
    R = random_pose(np.random.default_rng(3), angle_deg)[:3, :3]
    q = quat_wxyz(R)
    assert q[0] >= -1e-12
    assert Rotation.from_quat([*q[1:], q[0]]).as_matrix() == pytest.approx(R, abs=1e-9)


def test_nearest_rotation_mends_scale_and_shear():
    rng = np.random.default_rng(4)
    R = random_pose(rng)[:3, :3]
    mended = nearest_rotation(1.02 * R + 1e-4 * rng.normal(size=(3, 3)))
    assert mended @ mended.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(mended) == pytest.approx(1.0)
    assert mended == pytest.approx(R, abs=1e-3)


def test_aligned_points_give_back_the_motion():
    rng = np.random.default_rng(5)
    T_a_b, p_b = random_pose(rng), rng.normal(size=(6, 3))
    assert align_points(transform(T_a_b, p_b), p_b) == pytest.approx(T_a_b, abs=1e-9)


def test_a_mirror_image_is_not_taken_for_a_motion():
    p = np.random.default_rng(6).normal(size=(8, 3))
    T = align_points(p * [1, 1, -1], p)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
