"""Poses from matches of which most are wrong."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.features.triangles import TRIANGLES, poses_by_triangles
from fleetpose.pose_server.geometry.se3 import (
    exp_so3,
    inverse,
    make_pose,
    rotation_angle,
    transform,
)

K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]])
SIZE = (640, 480)
DEPTH_SIGMA = 0.005


def observed(points, rng=None, depth_sigma=DEPTH_SIGMA):
    """Points (N, 3) of a camera frame as it measures them."""
    uvw = points @ K.T
    uv, inverse_depth = uvw[:, :2] / uvw[:, 2:], 1 / points[:, 2]
    if rng is not None:
        uv = uv + rng.normal(scale=0.5, size=uv.shape)
        inverse_depth = inverse_depth * (1 + rng.normal(scale=depth_sigma, size=len(points)))
    return Observed(K, SIZE, uv, inverse_depth, depth_sigma * inverse_depth, 0.5)


def in_sight(rng, count, depth_m):
    u, v = rng.uniform(40, 600, count), rng.uniform(40, 440, count)
    z = depth_m * rng.uniform(0.7, 1.3, count)
    return np.column_stack((u, v, np.ones(count))) @ np.linalg.inv(K).T * z[:, None]


def two_views(seed, right, wrong, depth_m=2.0):
    """Two views, matches of which so many are right, which ones, and the true pose."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    R = exp_so3(rng.uniform(0.1, 0.7) * axis / np.linalg.norm(axis))
    centre = np.array([0.0, 0.0, depth_m])
    T = make_pose(R, centre - R @ centre)  # both look at the same place
    p_i = in_sight(rng, right + wrong, depth_m)
    p_j = np.concatenate((transform(inverse(T), p_i[:right]), in_sight(rng, wrong, depth_m)))
    order = rng.permutation(right + wrong)
    i, j = observed(p_i[order], rng), observed(p_j[order], rng)
    matches = np.column_stack((np.arange(right + wrong),) * 2)
    return i, j, matches, np.flatnonzero(order < right), T


@pytest.mark.parametrize("depth_m", [0.2, 2.0, 500.0])
def test_thirty_right_matches_are_found_among_five_hundred_at_any_scale(depth_m):
    for seed in range(8):
        i, j, matches, right, T_true = two_views(seed, 30, 500, depth_m)
        T, agrees = poses_by_triangles(i, j, matches, depth_m)[0]
        assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 0.05 * depth_m
        assert rotation_angle(T[:3, :3].T @ T_true[:3, :3]) < 0.05
        found = np.intersect1d(agrees[:, 0], right)
        assert len(found) > 20
        assert len(found) > 0.8 * len(agrees)


def test_the_answer_is_the_same_every_time():
    i, j, matches, _, _ = two_views(3, 20, 300)
    first, second = (poses_by_triangles(i, j, matches, 2.0) for _ in range(2))
    assert len(first) == len(second) > 0
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


def test_what_is_not_there_has_hardly_any_matches():
    for seed in range(5):
        i, j, matches, _, _ = two_views(seed, 0, 400)
        for T, agrees in poses_by_triangles(i, j, matches, 2.0):
            assert len(agrees) < 0.05 * len(matches)
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
            assert np.linalg.det(T[:3, :3]) > 0


def test_two_poses_that_alike_many_agree_on_are_both_found():
    """Two rigid groups move differently, as a scene and a large robot in it would."""
    a, b = two_views(1, 80, 100), two_views(2, 70, 100)
    joined = [
        Observed(
            K,
            SIZE,
            *(
                np.concatenate((getattr(x, name), getattr(y, name)))
                for name in ("uv", "inverse_depth", "inverse_depth_sigma")
            ),
            0.5,
        )
        for x, y in zip(a[:2], b[:2], strict=True)
    ]
    matches = np.column_stack((np.arange(len(joined[0].uv)),) * 2)
    found = poses_by_triangles(joined[0], joined[1], matches, 2.0)
    for true in (a[4], b[4]):
        assert any(np.linalg.norm(T[:3, 3] - true[:3, 3]) < 0.1 for T, _ in found[:3])


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_matches_make_no_pose(count):
    i, j, matches, _, _ = two_views(0, 5, 0)
    assert poses_by_triangles(i, j, matches[:count], 2.0) == []


@pytest.mark.parametrize("kind", ["coincident", "collinear"])
def test_points_that_span_no_triangle_make_no_pose(kind):
    rng = np.random.default_rng(0)
    along = np.zeros(40) if kind == "coincident" else np.linspace(-0.5, 0.5, 40)
    points = np.column_stack((along, 0.3 * along, 2.0 + 0.2 * along))
    i, j = observed(points), observed(points[rng.permutation(40)])
    matches = np.column_stack((np.arange(40),) * 2)
    assert poses_by_triangles(i, j, matches, 2.0) == []


def test_matches_beyond_the_most_trusted_are_left_out():
    i, j, matches, _, _ = two_views(0, TRIANGLES.most_matches + 200, 0)
    _, agrees = poses_by_triangles(i, j, matches, 2.0)[0]
    assert agrees[:, 0].max() < TRIANGLES.most_matches
