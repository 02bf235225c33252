"""The operator's start: what clicks give, what they do not, and who is to be believed."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server.geometry import dlt
from fleetpose.pose_server.geometry.errors import DegenerateGeometryError
from fleetpose.pose_server.geometry.gravity import Gravity
from fleetpose.pose_server.geometry.se3 import inverse, retract, rotation_angle, transform
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.clicked import with_clicks
from fleetpose.pose_server.registration.operator_starts import (
    Clicks,
    OperatorStart,
    operator_starts,
    starts_from_clicks,
)
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from tests.pose_server.scene import pair_of_views, turned

T_TRUE = turned(50)
POINTS = np.array([[-3, -2, 9], [3, -2, 11], [0, 2.5, 10], [-2, 2, 11.5], [2.5, 1, 8.5]], float)
I, J = (prepare_view(v) for v in pair_of_views(np.random.default_rng(0), T_TRUE))  # noqa: E741
UNDETERMINED = PairResult(None, None, "rejected", ("no start",))


def clicked(points: np.ndarray, T_i_j: np.ndarray = T_TRUE) -> Clicks:
    """Exact clicks, depths known to 10 cm."""
    at_j = transform(inverse(T_i_j), points)
    K = I.observed.K
    uv_i, uv_j = ((p @ K.T)[:, :2] / p[:, 2:] for p in (points, at_j))
    sigma = np.full(len(points), 0.1)
    return Clicks(uv_i, uv_j, points[:, 2], at_j[:, 2], sigma, sigma)


def start_from_clicks(*given) -> OperatorStart:
    """Where there is only one."""
    (start,) = starts_from_clicks(*given)
    return start


def told(result: PairResult, clicks: Clicks) -> PairResult:
    """What becomes of a result by clicks."""
    return with_clicks(result, operator_starts(I, J, clicks, ()), clicks, I, J)


def slipped(clicks: Clicks, k: int, by_px: tuple[float, float]) -> Clicks:
    uv_j = clicks.uv_j.copy()
    uv_j[k] += by_px
    return replace(clicks, uv_j=uv_j)


@pytest.mark.parametrize("wrong", range(5))
def test_a_wrong_click_of_five_is_named_and_does_not_move_the_start(wrong):
    found = start_from_clicks(I, J, slipped(clicked(POINTS), wrong, (40, -30)), ())
    assert list(np.nonzero(~found.inliers)[0]) == [wrong]
    assert np.allclose(found.start.T_i_j, T_TRUE, atol=1e-3)


def test_the_model_is_what_the_points_determine():
    models = {n: start_from_clicks(I, J, clicked(POINTS[:n]), ()).model for n in (3, 4, 5)}
    assert models == {3: "rigid", 4: "affine", 5: "projective"}


def test_two_clicks_and_gravity_give_a_start():
    up_j = np.array([0.0, -1.0, 0.0])
    gravity = Gravity(T_TRUE[:3, :3] @ up_j, up_j)
    found = start_from_clicks(I, J, clicked(POINTS[:2]), (), gravity)
    assert found.model == "upright" and not found.alone
    assert np.allclose(found.start.T_i_j, T_TRUE, atol=1e-3)


@pytest.mark.parametrize("points", [POINTS[:1], POINTS[:2], np.linspace(POINTS[0], POINTS[1], 4)])
def test_too_few_clicks_and_clicks_on_a_line_take_the_rotation_from_elsewhere(points):
    found = start_from_clicks(I, J, clicked(points), [Start("graph", T_TRUE, 0.02)])
    assert found.model == "translation" and found.covariance is None
    assert np.allclose(found.start.T_i_j, T_TRUE, atol=1e-6)


@pytest.mark.parametrize("points", [POINTS[:1], POINTS[:2], np.linspace(POINTS[0], POINTS[1], 4)])
def test_where_nothing_tells_the_rotation_they_shift_only_as_in_the_paper(points):
    found = start_from_clicks(I, J, clicked(points), ())
    assert found.model == "translation" and found.note
    assert np.array_equal(found.linear[:3, :3], np.eye(3))
    centre = transform(inverse(T_TRUE), points).mean(axis=0)
    assert np.allclose(transform(found.linear, centre[None]), points.mean(axis=0))


def test_one_click_stands_upright_where_gravity_is_known():
    up_j = np.array([0.0, -1.0, 0.0])
    gravity = Gravity(turned(8)[:3, :3] @ T_TRUE[:3, :3] @ up_j, up_j)
    found = start_from_clicks(I, J, clicked(POINTS[:1]), (), gravity)
    assert np.allclose(found.linear[:3, :3] @ up_j, gravity.up_a, atol=1e-9)


def test_two_clicks_above_each_other_step_down_to_a_shift_and_say_why():
    up_j = np.array([0.0, -1.0, 0.0])
    gravity = Gravity(T_TRUE[:3, :3] @ up_j, up_j)
    above = np.array([[0.5, -2.0, 10.0], [0.5, 2.0, 10.0]])
    found = start_from_clicks(I, J, clicked(above), [Start("graph", T_TRUE, 0.02)], gravity)
    assert found.model == "translation" and "above each other" in found.note
    assert np.allclose(found.start.T_i_j, T_TRUE, atol=1e-6)


@pytest.mark.parametrize("count", [3, 4, 5])
def test_the_linear_start_and_the_refined_one_compete(count):
    rng = np.random.default_rng(2)
    noisy = clicked(POINTS[:count])
    noisy = replace(noisy, z_i=noisy.z_i + rng.normal(0, 0.05, count))
    (found,) = starts_from_clicks(I, J, noisy, ())
    assert [start.kind for start in found.starts] == ["operator", "dlt"]
    assert np.array_equal(found.starts[1].T_i_j, found.linear)
    p_i, p_j = found.pairs.p_a, found.pairs.p_b
    assert np.allclose(found.linear, dlt.fit(p_i, p_j, largest="projective").T_a_b)


def test_millimetres_and_what_is_not_finite_are_named():
    clicks = clicked(POINTS)
    with pytest.raises(DegenerateGeometryError, match="metres"):
        start_from_clicks(I, J, replace(clicks, z_j=1e3 * clicks.z_j), ())
    with pytest.raises(DegenerateGeometryError, match="not finite"):
        start_from_clicks(I, J, replace(clicks, z_j=np.full(5, np.nan)), ())
    assert operator_starts(I, J, replace(clicks, z_j=np.full(5, np.nan)), ()) == []


def test_clicks_that_contradict_each_other_never_stand_alone():
    clicks = slipped(clicked(POINTS[:3]), 0, (200, 150))
    found = start_from_clicks(I, J, clicks, ())
    assert "contradict" in found.note
    result = told(UNDETERMINED, clicks)
    assert (result.verdict, result.T_i_j, result.confirmed) == ("rejected", None, False)
    assert result.hearing is not None and "contradict each other" in result.hearing.told


def test_what_features_made_of_the_clicks_is_kept_where_the_clicks_agree_with_it():
    rng = np.random.default_rng(1)
    noisy = clicked(POINTS[:3])
    noisy = replace(noisy, z_i=noisy.z_i + rng.normal(0, 0.1, 3))
    operator = start_from_clicks(I, J, noisy, ())
    assert rotation_angle(operator.start.T_i_j[:3, :3].T @ T_TRUE[:3, :3]) > 1e-3
    weak = PairResult(T_TRUE, None, "rejected", ("only 6 matches agree, need 8",), start="features")
    found = told(weak, noisy)
    assert found.verdict == "plausible" and found.T_i_j is T_TRUE
    assert np.allclose(found.covariance, operator.covariance)
    far = retract(T_TRUE, np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    own = told(replace(weak, T_i_j=far), noisy)
    assert operator.suits(own.T_i_j) and own.start == "operator"
    assert found.confirmed and own.confirmed


def test_a_plausible_pose_yields_to_clicks_that_contradict_it_and_a_verified_one_does_not():
    far = retract(T_TRUE, np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    result = PairResult(far, np.eye(6), "plausible", ("some matches agree",), start="features")
    found = told(result, clicked(POINTS))
    assert np.allclose(found.T_i_j, T_TRUE, atol=0.05) and found.confirmed
    verified = replace(result, T_i_j=T_TRUE, verdict="verified")
    found = told(verified, clicked(POINTS, far))
    assert found.T_i_j is T_TRUE and not found.confirmed
    assert found.hearing is not None and "fit another pose" in found.hearing.told


def test_clicks_confirm_a_plausible_pose_that_features_found_first():
    near = PairResult(T_TRUE, np.eye(6), "plausible", ("some",), start="features")
    found = told(near, clicked(POINTS))
    assert found.T_i_j is T_TRUE and found.confirmed and found.start == "features"
    few = told(near, clicked(POINTS[:2]))
    assert few.T_i_j is T_TRUE and not few.confirmed


@pytest.mark.parametrize("seed", [3, 9, 53])
def test_the_linear_start_wins_where_depths_are_worse_than_stated(seed):
    """Half of the depths are stated a hundred times too good: the refined start follows them."""
    rng = np.random.default_rng(seed)
    clicks = clicked(POINTS)
    z = [depths * (1 + rng.normal(0, 0.04, 5)) for depths in (clicks.z_i, clicks.z_j)]
    sigma = [np.where(rng.random(5) < 0.5, 0.02, 2.0) for _ in range(2)]
    clicks = replace(clicks, z_i=z[0], z_j=z[1], sigma_i=sigma[0], sigma_j=sigma[1])
    found = start_from_clicks(I, J, clicks, ())
    both = align_pair(I, J, found.starts, features=False)
    alone = align_pair(I, J, [found.start], features=False)
    assert (both.start, both.verdict, alone.verdict) == ("dlt", "verified", "rejected")
    assert np.linalg.norm(both.T_i_j[:3, 3] - T_TRUE[:3, 3]) < 0.05
