"""Rigid motions, linear transformations, refinement, lifting, matching: axioms and known truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.features.matching import one_to_one, ratio_matches
from fleetpose.pose_server.geometry.features.refine import refine
from fleetpose.pose_server.geometry.lift import lift_pixel
from fleetpose.pose_server.geometry.noise import PointNoise
from fleetpose.pose_server.geometry.se3 import (
    adjoint,
    compose_covariance,
    exp_so3,
    inverse,
    log_so3,
    make_pose,
    retract,
    rotation_angle,
)
from tests.pose_server.scene import K, observed_pair, turned

vectors = st.lists(st.floats(-3.1, 3.1), min_size=3, max_size=3).map(np.array)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return make_pose(exp_so3(rng.normal(0, 1, 3)), rng.normal(0, 5, 3))


@given(vectors)
def test_log_undoes_exp_up_to_half_a_turn(w):
    if np.linalg.norm(w) < np.pi - 1e-3:
        assert np.allclose(log_so3(exp_so3(w)), w, atol=1e-6)


@given(vectors, vectors)
def test_inverse_and_adjoint_are_consistent(w, t):
    T = make_pose(exp_so3(w), t)
    assert np.allclose(inverse(T) @ T, np.eye(4), atol=1e-9)
    small = np.array([1e-6, -2e-6, 1e-6, 3e-6, 1e-6, -1e-6])
    right = T @ retract(np.eye(4), small)
    assert np.allclose(right, retract(T, adjoint(T) @ small), atol=1e-10)


def test_composed_covariance_is_that_of_many_draws():
    rng = np.random.default_rng(0)
    T_a_b, T_b_c = random_pose(rng), random_pose(rng)
    C_ab, C_bc = (np.diag(rng.uniform(1e-6, 4e-6, 6)) for _ in range(2))
    errors = []
    for _ in range(4000):
        noisy = retract(T_a_b, rng.multivariate_normal(np.zeros(6), C_ab)) @ retract(
            T_b_c, rng.multivariate_normal(np.zeros(6), C_bc)
        )
        E = noisy @ inverse(T_a_b @ T_b_c)
        errors.append(np.concatenate((log_so3(E[:3, :3]), E[:3, 3])))
    expected = compose_covariance(T_a_b, C_ab, C_bc)
    drawn = np.cov(np.array(errors).T)
    assert np.allclose(drawn, expected, atol=0.1 * np.abs(expected).max())


def test_refinement_is_as_good_as_its_covariance_says():
    rng = np.random.default_rng(7)
    T_true = turned(20)
    nees = []
    for _ in range(40):
        i, j = observed_pair(rng, T_true, 80)
        matches = np.column_stack((np.arange(80), np.arange(80)))
        found = refine(i, j, matches, retract(T_true, rng.normal(0, 0.02, 6)), estimate_noise=False)
        E = T_true @ inverse(found.T_i_j)
        xi = np.concatenate((log_so3(E[:3, :3]), E[:3, 3]))
        nees.append(xi @ found.information @ xi / 6)
    assert 0.5 < np.mean(nees) < 1.6


def test_a_third_of_wrong_matches_does_not_move_the_refined_pose():
    rng = np.random.default_rng(8)
    T_true = turned(15)
    i, j = observed_pair(rng, T_true, 120)
    order = np.arange(120)
    order[:40] = rng.permutation(40)
    wrong = order != np.arange(120)
    matches = np.column_stack((np.arange(120), order))
    found = refine(i, j, matches, retract(T_true, np.full(6, 0.01)))
    assert np.linalg.norm(found.T_i_j[:3, 3] - T_true[:3, 3]) < 0.05
    assert found.inliers[~wrong].mean() > 0.9
    assert found.inliers[wrong].mean() < 0.1


def test_matches_with_depth_on_one_side_only_are_enough():
    rng = np.random.default_rng(9)
    T_true = turned(15)
    i, j = observed_pair(rng, T_true, 60)
    i.inverse_depth[::2] = np.nan
    j.inverse_depth[1::2] = np.nan
    matches = np.column_stack((np.arange(60), np.arange(60)))
    found = refine(i, j, matches, retract(T_true, np.full(6, 0.01)))
    assert np.linalg.norm(found.T_i_j[:3, 3] - T_true[:3, 3]) < 0.15
    i.inverse_depth[:] = j.inverse_depth[:] = np.nan
    with pytest.raises(DegenerateGeometryError, match="need 3"):
        refine(i, j, matches, T_true)


NOISE = PointNoise(0.5, (0.0, 0.0, 0.001))


def grid(z_of) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[200:240, 300:340]
    uv = np.column_stack((u.ravel(), v.ravel())).astype(float)
    return uv, z_of(uv)


def test_lifting_never_takes_a_mean_across_a_depth_edge():
    uv, z = grid(lambda uv: np.where(uv[:, 0] < 320, 2.0, 5.0))
    for u in np.linspace(316, 324, 33):
        lifted = lift_pixel(np.array([u, 220.0]), uv, z, K, NOISE, 2.0)
        assert min(abs(lifted.p[2] - 2.0), abs(lifted.p[2] - 5.0)) < 1e-6


def test_lifting_follows_a_slanted_plane_between_the_points():
    uv, z = grid(lambda uv: 1.0 / (0.4 + 0.0005 * (uv[:, 0] - 320)))
    lifted = lift_pixel(np.array([317.4, 222.7]), uv, z, K, NOISE, 2.0)
    assert lifted.p[2] == pytest.approx(1.0 / (0.4 + 0.0005 * (317.4 - 320)), rel=1e-4)
    assert lifted.C[2, 2] > lifted.C[0, 0]


def test_no_depth_says_how_far_the_nearest_point_is():
    uv, z = grid(lambda uv: np.full(len(uv), 3.0))
    with pytest.raises(DegenerateGeometryError, match="12 px away"):
        lift_pixel(np.array([351.0, 220.0]), uv, z, K, NOISE, 2.0)
    with pytest.raises(DegenerateGeometryError, match="no depth anywhere"):
        lift_pixel(np.array([351.0, 220.0]), uv[:0], z[:0], K, NOISE, 2.0)


@settings(max_examples=30)
@given(st.integers(0, 10_000), st.integers(3, 600), st.integers(3, 40))
def test_ratio_matches_are_mutual_and_one_to_one(seed, n, m):
    rng = np.random.default_rng(seed)
    a, b = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in rng.normal(size=(2, 600, 4)))
    a, b = a[:n].astype(np.float32), b[:m].astype(np.float32)
    matches, cosines = ratio_matches(a, b, 0.95)
    assert len(np.unique(matches[:, 0])) == len(np.unique(matches[:, 1])) == len(matches)
    every = a.astype(float) @ b.astype(float).T
    for (k, m), cosine in zip(matches, cosines, strict=True):
        assert cosine == pytest.approx(every[k].max(), abs=1e-5)
        assert every[k, m] == pytest.approx(every[k].max(), abs=1e-5)
        assert every[k, m] == pytest.approx(every[:, m].max(), abs=1e-5)


def test_twins_and_other_kinds_of_descriptors_do_not_confuse_matching():
    d = np.eye(4, 8, dtype=np.float32)
    matches, _ = ratio_matches(np.concatenate((d, d)), d, 0.95)
    assert len(np.unique(matches[:, 1])) == len(matches)
    assert len(ratio_matches(d, np.eye(4, 6, dtype=np.float32), 0.95)[0]) == 0


def test_one_to_one_keeps_the_best():
    matches = np.array([[0, 0], [0, 1], [1, 1], [2, 1]])
    kept = one_to_one(matches, np.array([0.5, 0.9, 0.8, 0.1]))
    assert {tuple(m) for m in kept} == {(0, 1)}


def test_angle_by_chord_is_exact_for_tiny_turns():
    assert rotation_angle(exp_so3(np.array([1e-9, 0, 0]))) == pytest.approx(1e-9, rel=1e-3)


@settings(max_examples=60)
@given(st.integers(0, 10_000), st.floats(0.02, 0.5), st.floats(300, 339), st.floats(200, 239))
def test_lifting_stays_on_one_side_of_any_edge_and_owns_up_near_it(seed, density, u, v):
    """Sparse or dense, the depth is one that a surface has, and a doubtful one is unsure."""
    rng = np.random.default_rng(seed)
    uv, z = grid(lambda uv: np.where(uv[:, 0] + 0.3 * uv[:, 1] < 386, 2.0, 5.0))
    some = rng.random(len(z)) < density
    try:
        lifted = lift_pixel(np.array([u, v]), uv[some], z[some], K, NOISE, 6.0)
    except DegenerateGeometryError as error:
        assert "px away" in str(error) or "no depth" in str(error)
        return
    miss = min(abs(lifted.p[2] - 2.0), abs(lifted.p[2] - 5.0))
    assert miss < 1e-6
    truth = 2.0 if u + 0.3 * v < 386 else 5.0
    assert abs(lifted.p[2] - truth) < 6 * lifted.sigma_z
    assert np.linalg.eigvalsh(lifted.C)[0] > 0


def test_a_lone_wrong_depth_under_the_click_is_outvoted():
    uv, z = grid(lambda uv: np.full(len(uv), 3.0))
    z[(uv == [320, 220]).all(axis=1)] = 7.0
    assert lift_pixel(np.array([320.0, 220.0]), uv, z, K, NOISE, 2.0).p[2] == pytest.approx(3.0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0, -1.0])
def test_what_is_no_depth_is_not_lifted(bad):
    uv, z = grid(lambda uv: np.full(len(uv), 3.0))
    z[uv[:, 0] < 330] = bad
    assert lift_pixel(np.array([329.0, 220.0]), uv, z, K, NOISE, 2.0).p[2] == pytest.approx(3.0)
    with pytest.raises(DegenerateGeometryError, match="10 px away"):
        lift_pixel(np.array([320.0, 220.0]), uv, z, K, NOISE, 2.0)
    with pytest.raises(DegenerateGeometryError, match="not finite"):
        lift_pixel(np.array([np.nan, 220.0]), uv, z, K, NOISE, 2.0)


def test_lifting_is_the_same_at_any_scale_of_the_scene():
    uv, z = grid(lambda uv: 1.0 / (0.4 + 0.0005 * (uv[:, 0] - 320)))
    at = np.array([317.4, 222.7])
    one = lift_pixel(at, uv, z, K, NOISE, 2.0)
    for scale in (1e-2, 1e3):
        noise = PointNoise(0.5, (0.0, 0.0, 0.001 / scale))
        other = lift_pixel(at, uv, scale * z, K, noise, 2.0)
        assert np.allclose(other.p, scale * one.p)
        assert np.allclose(other.C, scale**2 * one.C, rtol=0.02)
