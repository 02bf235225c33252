"""Which clicks agree: a wrong one is named, right ones are not, the pose knows how good it is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.geometry.consensus import OUTLIER_CHI2, consensus, consistent_sets
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.point_pairs import PointPairs
from fleetpose.pose_server.geometry.se3 import inverse, log_so3, transform
from tests.pose_server.point_makers import random_pose, round_the_scene, seeds, seen_by_two


def with_a_slip(pairs: PointPairs, k: int, by: np.ndarray) -> PointPairs:
    p_b = pairs.p_b.copy()
    p_b[k] += by
    return PointPairs(pairs.p_a, p_b, pairs.C_a, pairs.C_b)


def slip(rng: np.random.Generator) -> np.ndarray:
    """1.5 m aside in the image, the width of a window."""
    angle = rng.uniform(0, 2 * np.pi)
    return 1.5 * np.array([np.cos(angle), np.sin(angle), 0.0])


@pytest.mark.parametrize("count", [5, 6, 9])
def test_a_wrong_click_is_named_and_no_other(count):
    rng = np.random.default_rng(0)
    named = 0
    for _ in range(50):
        k = int(rng.integers(count))
        pairs = with_a_slip(seen_by_two(rng, round_the_scene(rng), count), k, slip(rng))
        found = consensus(pairs)
        named += list(np.nonzero(~found.inliers)[0]) == [k]
        assert found.distance2[~found.inliers].min(initial=np.inf) > 0.9 * OUTLIER_CHI2
    assert named >= 48


@pytest.mark.parametrize("count", [3, 4, 5, 12])
def test_right_clicks_are_left_alone(count):
    rng = np.random.default_rng(1)
    found = [consensus(seen_by_two(rng, round_the_scene(rng), count)) for _ in range(100)]
    assert sum(one.inliers.all() for one in found) >= 96  # each is named once in a thousand
    assert sum(not one.contradiction for one in found) >= 99


@pytest.mark.parametrize("wrong", [0, 1])
def test_the_covariance_is_that_of_the_errors(wrong):
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(150):
        T = round_the_scene(rng)
        pairs = seen_by_two(rng, T, 6)
        found = consensus(with_a_slip(pairs, 0, slip(rng)) if wrong else pairs)
        E = T @ inverse(found.T_a_b)
        xi = np.concatenate((log_so3(E[:3, :3]), E[:3, 3]))
        nees.append(xi @ np.linalg.solve(found.covariance, xi) / 6)
    assert 0.8 < np.mean(nees) < 1.25


@given(seeds, st.sampled_from(((3, 0.0), (4, 0.0), (5, 0.0), (5, 1.0))))
@settings(max_examples=30, deadline=None)
def test_moving_either_frame_changes_nothing_but_the_pose(rng, clicked):
    count, slipped = clicked
    pairs = with_a_slip(seen_by_two(rng, round_the_scene(rng), count), 0, slipped * slip(rng))
    A, B = random_pose(rng), random_pose(rng)
    R_a, R_b = A[:3, :3], B[:3, :3]
    moved = PointPairs(
        transform(A, pairs.p_a), transform(B, pairs.p_b), R_a @ pairs.C_a @ R_a.T,
        R_b @ pairs.C_b @ R_b.T,
    )  # fmt: skip
    one, other = consensus(pairs), consensus(moved)
    assert (one.inliers == other.inliers).all()
    assert np.allclose(other.T_a_b, A @ one.T_a_b @ inverse(B), atol=1e-3)
    assert np.allclose(one.distance2, other.distance2, rtol=1e-2, atol=1e-2)


@given(seeds, st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_the_size_of_the_scene_does_not_matter(rng, size):
    pairs = with_a_slip(seen_by_two(rng, round_the_scene(rng), 5), 1, slip(rng))
    scaled = PointPairs(
        size * pairs.p_a, size * pairs.p_b, size**2 * pairs.C_a, size**2 * pairs.C_b
    )
    one, other = consensus(pairs), consensus(scaled)
    assert (one.inliers == other.inliers).all()
    assert np.allclose(one.distance2, other.distance2, rtol=1e-3, atol=1e-3)


def both(one: PointPairs, other: PointPairs) -> PointPairs:
    names = ("p_a", "p_b", "C_a", "C_b")
    return PointPairs(*(np.concatenate((getattr(one, n), getattr(other, n))) for n in names))


@pytest.mark.parametrize(("wrong", "right"), [(3, 3), (6, 3), (4, 4), (3, 4), (10, 5)])
def test_right_ones_are_among_the_sets_that_agree_however_many_wrong_ones_fit_each_other(
    wrong, right
):
    rng = np.random.default_rng(9)
    for _ in range(5):
        T, step = round_the_scene(rng), slip(rng)
        astray = seen_by_two(rng, T, wrong)
        astray = PointPairs(astray.p_a, astray.p_b + step, astray.C_a, astray.C_b)
        sets = consistent_sets(both(astray, seen_by_two(rng, T, right)))
        expected = np.arange(wrong + right) >= wrong
        among = [k for k, one in enumerate(sets) if (one.inliers == expected).all()]
        assert among and among[0] < 3
        assert all(not one.contradiction and one.inliers.sum() >= 3 for one in sets)


def test_where_all_or_all_but_one_agree_there_is_one_set():
    rng = np.random.default_rng(10)
    pairs = seen_by_two(rng, round_the_scene(rng), 6)
    (found,) = consistent_sets(pairs)
    assert (found.inliers == consensus(pairs).inliers).all()
    (found,) = consistent_sets(with_a_slip(pairs, 2, slip(rng)))
    assert found.inliers.sum() >= 5


def test_sets_of_what_determines_nothing_are_refused_as_the_whole_is():
    pairs = seen_by_two(np.random.default_rng(8), np.eye(4), 12)
    p = np.outer(np.linspace(1, 2, 12), [1.0, 1.0, 5.0])
    with pytest.raises(DegenerateGeometryError, match="one line"):
        consistent_sets(PointPairs(p, p, pairs.C_a, pairs.C_b))


def test_a_pose_found_elsewhere_judges_more_sharply_than_clicks_among_themselves():
    rng = np.random.default_rng(3)
    T = round_the_scene(rng)
    pairs = with_a_slip(seen_by_two(rng, T, 4), 2, 0.6 * slip(rng))
    judged = pairs.distance2(T) > OUTLIER_CHI2
    assert list(judged) == [False, False, True, False]
    found = consensus(pairs[np.array([0, 1, 3])])
    loose = pairs.distance2(found.T_a_b, found.covariance)[2]
    assert loose < pairs.distance2(T)[2]


def test_three_that_contradict_each_other_say_so():
    rng = np.random.default_rng(4)
    pairs = seen_by_two(rng, round_the_scene(rng), 3)
    apart = pairs.p_b[0] - pairs.p_b[1]
    found = consensus(with_a_slip(pairs, 0, 0.5 * apart))
    assert "3 correspondences contradict each other" in found.contradiction
    assert found.inliers.all()  # nobody knows which


def test_a_mirrored_frame_is_refused():
    rng = np.random.default_rng(5)
    flip = np.diag([-1.0, 1.0, 1.0])
    for _ in range(20):
        pairs = seen_by_two(rng, round_the_scene(rng), 6)
        mirrored = PointPairs(pairs.p_a, pairs.p_b @ flip, pairs.C_a, flip @ pairs.C_b @ flip)
        with pytest.raises(DegenerateGeometryError, match="mirror image"):
            consensus(mirrored)


def test_millimetres_are_named():
    pairs = seen_by_two(np.random.default_rng(6), np.eye(4), 5)
    with pytest.raises(DegenerateGeometryError, match=r"0\.00\d+ times as long"):
        consensus(PointPairs(pairs.p_a, 1e3 * pairs.p_b, pairs.C_a, 1e6 * pairs.C_b))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_are_refused(count):
    pairs = seen_by_two(np.random.default_rng(7), np.eye(4), 3)
    with pytest.raises(DegenerateGeometryError, match=r"need 3|0 correspondences"):
        consensus(pairs[np.arange(count)])


def test_a_line_is_refused_however_many_there_are():
    pairs = seen_by_two(np.random.default_rng(8), np.eye(4), 12)
    p = np.outer(np.linspace(1, 2, 12), [1.0, 1.0, 5.0])
    with pytest.raises(DegenerateGeometryError, match="one line"):
        consensus(PointPairs(p, p, pairs.C_a, pairs.C_b))


@settings(max_examples=100, deadline=None)
@given(
    seeds,
    st.integers(1, 6),
    st.sampled_from((1e-6, 1.0, 1e6)),
    st.sampled_from((0.0, 1e6)),
    st.sampled_from((None, np.nan, np.inf)),
)
def test_whatever_comes_gives_a_motion_or_a_named_error(rng, count, size, far, bad):
    p_a, p_b = size * rng.normal(0, 1, (2, count, 3)) + far
    if bad is not None:
        p_a[0, 0] = bad
    C = np.tile(1e-4 * size**2 * np.eye(3), (count, 1, 1))
    try:
        found = consensus(PointPairs(p_a, p_b, C, C))
    except DegenerateGeometryError as error:
        assert str(error)
        return
    assert bad is None and np.isfinite(found.T_a_b).all() and np.isfinite(found.covariance).all()
    assert np.linalg.eigvalsh(found.covariance)[0] > -1e-9 * np.trace(found.covariance)
    assert found.inliers.sum() >= 3
