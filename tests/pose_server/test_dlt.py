"""Linear models: each recovers what it was made from, and steps down where the points are too
few."""

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from fleetpose.pose_server.geometry import dlt
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, transform
from tests.pose_server.point_makers import random_pose, seeds

EXACT = {"rtol": 1e-6, "atol": 1e-6}


def corners(rng: np.random.Generator, count: int) -> np.ndarray:
    """Points in general position: a tetrahedron, its middle, and more, a little moved."""
    ideal = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1], [0.1, -0.2, 0.4]])
    more = rng.uniform(-1, 1, (max(count - 5, 0), 3))
    return np.vstack((ideal, more))[:count] + rng.uniform(-0.03, 0.03, (count, 3))


@given(seeds, st.integers(4, 9))
def test_affine_is_recovered_from_four_points_on(rng, count):
    H = np.eye(4)
    H[:3] = rng.normal(0, 1, (3, 4))
    p_b = 3 * corners(rng, count) + 100.0
    assert np.allclose(dlt.apply(dlt.affine(dlt.apply(H, p_b), p_b), p_b), dlt.apply(H, p_b))


@given(seeds, st.integers(5, 12))
def test_projective_is_recovered_from_five_points_on(rng, count):
    H = np.eye(4)
    H[:3] = random_pose(rng)[:3] + rng.uniform(-0.2, 0.2, (3, 4))
    H[3, :3] = rng.uniform(-0.1, 0.1, 3)
    p_b = corners(rng, count)
    try:
        found = dlt.projective(dlt.apply(H, p_b), p_b)
    except DegenerateGeometryError:  # by chance they lie so that they hardly determine one
        reject()
    elsewhere = rng.uniform(-1, 1, (20, 3))
    assert np.allclose(dlt.apply(found, elsewhere), dlt.apply(H, elsewhere), rtol=1e-4, atol=1e-4)


@given(seeds, st.integers(3, 9), st.floats(0.5, 2.0))
def test_similarity_is_recovered_with_its_scale(rng, count, scale):
    S = random_pose(rng)
    S[:3, :3] *= scale
    p_b = corners(rng, count)
    assert np.allclose(dlt.similarity(transform(S, p_b), p_b), S, **EXACT)
    assert dlt.fit(transform(S, p_b), p_b).scale == pytest.approx(scale)


@given(seeds, st.sampled_from((1e-3, 1.0, 1e3)), st.sampled_from((0.0, 1.0, 1e6)))
def test_rigid_motion_is_recovered_at_any_scale_and_far_from_the_origin(rng, scale, far):
    T = random_pose(rng, scale)
    p_b = scale * corners(rng, 3) + far * rng.normal(0, 1, 3)
    p_a = transform(T, p_b)
    found = dlt.fit(p_a, p_b)
    assert found.model == "rigid"
    assert np.allclose(transform(found.T_a_b, p_b), p_a, atol=1e-6 * scale + 1e-8 * far)


@given(seeds, st.sampled_from((3, 4, 5, 8)))
def test_moving_either_frame_moves_the_pose_accordingly(rng, count):
    p_b = corners(rng, count)
    p_a = transform(random_pose(rng), p_b) + rng.normal(0, 0.01, (count, 3))
    T, A, B = dlt.fit(p_a, p_b).T_a_b, random_pose(rng), random_pose(rng)
    moved = dlt.fit(transform(A, p_a), transform(B, p_b)).T_a_b
    assert np.allclose(moved, A @ T @ inverse(B), **EXACT)
    back = dlt.fit(p_b, p_a, largest="rigid").T_a_b
    assert np.allclose(back, inverse(dlt.fit(p_a, p_b, largest="rigid").T_a_b), **EXACT)


@given(seeds, st.sampled_from((3, 4, 5, 8)), st.floats(1e-3, 1e3))
def test_scaling_both_frames_scales_the_translation(rng, count, scale):
    p_b = corners(rng, count)
    p_a = transform(random_pose(rng), p_b) + rng.normal(0, 0.01, (count, 3))
    T, scaled = dlt.fit(p_a, p_b).T_a_b, dlt.fit(scale * p_a, scale * p_b).T_a_b
    assert np.allclose(scaled[:3, :3], T[:3, :3], **EXACT)
    assert np.allclose(scaled[:3, 3], scale * T[:3, 3], rtol=1e-6, atol=1e-6 * scale)


@given(seeds, st.permutations(range(6)))
def test_the_order_of_the_points_does_not_matter(rng, order):
    p_b = corners(rng, 6)
    p_a = transform(random_pose(rng), p_b) + rng.normal(0, 0.01, (6, 3))
    for largest in ("rigid", "affine", "projective"):
        T, S = dlt.fit(p_a, p_b, largest=largest), dlt.fit(p_a[order], p_b[order], largest=largest)
        assert np.allclose(T.T_a_b, S.T_a_b, **EXACT)


@given(seeds)
def test_of_exact_points_every_model_has_the_same_nearest_rigid_motion(rng):
    T, p_b = random_pose(rng), corners(rng, 8)
    p_a = transform(T, p_b)
    for model in (dlt.projective, dlt.affine, dlt.similarity, dlt.rigid):
        assert np.allclose(dlt.nearest_rigid(model(p_a, p_b), p_b), T, **EXACT)


@given(seeds, st.sampled_from(("affine", "projective")))
def test_points_in_a_plane_step_down_to_a_rigid_motion_and_say_so(rng, largest):
    p_b = np.column_stack((corners(rng, 6)[:, :2], np.zeros(6)))
    T = random_pose(rng)
    found = dlt.fit(transform(T, p_b), p_b, largest=largest)
    assert found.model == "rigid" and "one plane" in found.note
    assert np.allclose(found.T_a_b, T, **EXACT)


@given(seeds)
def test_four_of_five_in_one_plane_step_down_to_an_affine_map(rng):
    p_b = corners(rng, 5)
    p_b[:4, 2] = 0.0
    p_b[4, 2] = 1.0
    found = dlt.fit(transform(random_pose(rng), p_b), p_b, largest="projective")
    assert found.model == "affine" and "15th singular value" in found.note


@given(seeds, st.integers(2, 6))
def test_points_on_a_line_determine_a_shift_only_and_never_a_made_up_rotation(rng, count):
    p_b = np.outer(np.arange(count), [1.0, 2.0, 0.5])
    R = exp_so3(rng.normal(0, 1, 3))
    shift = rng.normal(0, 3, 3)
    found = dlt.fit(p_b @ R.T + shift, p_b, R)
    assert found.model == "translation" and "one line" in found.note
    assert np.allclose(found.T_a_b[:3, :3], R) and np.allclose(found.T_a_b[:3, 3], shift)
    with pytest.raises(DegenerateGeometryError, match=r"one line.*no rotation is known"):
        dlt.fit(p_b @ R.T + shift, p_b)


def test_coincident_points_and_a_single_one_say_so():
    for count in (1, 5):
        p = np.tile([1.0, 2.0, 3.0], (count, 1))
        with pytest.raises(DegenerateGeometryError, match=r"coincide.*no rotation"):
            dlt.fit(p, p)
        assert np.allclose(dlt.fit(p + 1, p, np.eye(3)).T_a_b[:3, 3], 1.0)


@given(seeds, st.integers(4, 10))
def test_mirror_images_are_refused_by_every_model(rng, count):
    p_b = corners(rng, count)
    p_a = transform(random_pose(rng), p_b * [-1, 1, 1]) + rng.normal(0, 1e-3, (count, 3))
    for largest in ("rigid", "affine", "projective"):
        with pytest.raises(DegenerateGeometryError, match="mirror image"):
            dlt.fit(p_a, p_b, largest=largest)


@given(seeds, st.integers(2, 8), st.sampled_from((1e3, 1e-3, 100.0, 39.37, 3.28)))
def test_other_units_are_named_with_the_factor(rng, count, factor):
    p_b = corners(rng, count)
    with pytest.raises(DegenerateGeometryError, match=r"times as long.*metres"):
        dlt.fit(transform(random_pose(rng), p_b) * factor, p_b, np.eye(3))


def test_depths_that_are_off_by_a_tenth_are_no_other_unit():
    p = corners(np.random.default_rng(0), 5)
    assert dlt.fit(1.1 * p, p).scale == pytest.approx(1.1)


BAD = st.sampled_from((np.nan, np.inf, -np.inf))


@given(seeds, st.integers(1, 6), BAD, st.booleans())
def test_what_is_not_finite_is_named(rng, count, bad, in_a):
    p_a, p_b = rng.normal(0, 1, (2, count, 3))
    (p_a if in_a else p_b)[rng.integers(count), rng.integers(3)] = bad
    models = (dlt.rigid, dlt.similarity, dlt.affine, dlt.projective, dlt.fit)
    for model in models:
        with pytest.raises(DegenerateGeometryError, match=f"1 of {count} .* not finite"):
            model(p_a, p_b)


@pytest.mark.parametrize("shape", [(0, 3), (3,), (4, 2)])
def test_no_points_and_points_of_another_shape_are_named(shape):
    with pytest.raises(DegenerateGeometryError, match="need"):
        dlt.fit(np.zeros(shape), np.zeros(shape))


@settings(max_examples=300)
@given(
    st.integers(1, 7).flatmap(
        lambda n: st.tuples(
            *[
                st.lists(
                    st.lists(st.floats(-1e7, 1e7), min_size=3, max_size=3), min_size=n, max_size=n
                )
            ]
            * 2
        )
    ),
    st.sampled_from(("rigid", "similarity", "affine", "projective")),
)
def test_whatever_comes_gives_a_motion_or_a_named_error(points, largest):
    p_a, p_b = (np.array(p) for p in points)
    try:
        found = dlt.fit(p_a, p_b, largest=largest)
    except DegenerateGeometryError as error:
        assert str(error)
        return
    R = found.T_a_b[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-9) and np.linalg.det(R) > 0
    assert np.isfinite(found.T_a_b).all() and np.isfinite(found.residuals_m).all()
