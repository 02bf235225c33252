"""Clicks are evidence like any other: images decide between sets of them, and name the wrong."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform
from fleetpose.pose_server.registration.clicked import CLICKED, with_clicks
from fleetpose.pose_server.registration.operator_starts import Clicks, operator_starts
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.registration.verdict.hearing import hear
from fleetpose.pose_server.workers.jobs import ClickJob, EncodedView
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import pack
from tests.pose_server.scene import K, descriptors, pair_of_views, turned, view, walls

T_TRUE = turned(40)
RIGHT = np.array([[-3, -2, 9], [3, -2, 11], [0, 2.5, 10], [-2, 2, 11.5], [2.5, 1, 8.5]], float)
STEP = np.array([1.5, 0.0, 0.0])  # one window further
UNDETERMINED = PairResult(None, None, "rejected", ("no start",))
MESSAGES = pair_of_views(np.random.default_rng(0), T_TRUE)
VIEWS = tuple(prepare_view(message) for message in MESSAGES)


def clicked(points: np.ndarray, meant: np.ndarray | None = None, T_i_j=T_TRUE) -> Clicks:
    """Exact clicks on world points in view i, and on those that were taken for them in view j."""
    at_j = transform(inverse(T_i_j), points if meant is None else meant)
    uv_i, uv_j = ((p @ K.T)[:, :2] / p[:, 2:] for p in (points, at_j))
    sigma = np.full(len(points), 0.1)
    return Clicks(uv_i, uv_j, points[:, 2], at_j[:, 2], sigma, sigma)


def together(*sets: Clicks) -> Clicks:
    columns = ("uv_i", "uv_j", "z_i", "z_j", "sigma_i", "sigma_j")
    return Clicks(*(np.concatenate([getattr(one, c) for one in sets]) for c in columns))


def told(result: PairResult, clicks: Clicks, views=VIEWS) -> PairResult:
    return with_clicks(result, operator_starts(*views, clicks, ()), clicks, *views)


def heard(clicks: Clicks, views=VIEWS):
    hearing = told(UNDETERMINED, clicks, views).hearing
    assert hearing is not None
    return hearing


@pytest.mark.parametrize("count", [3, 4, 5])
def test_wrong_clicks_that_fit_each_other_are_refused_and_named(count):
    points = RIGHT[:count]
    result = told(UNDETERMINED, clicked(points, points + STEP))
    assert result.verdict == "rejected" and not result.confirmed
    assert result.hearing is not None and result.hearing.accepted == (False,) * count
    assert f"your {count} points in r1 and r2 fit each other, but" in result.hearing.told
    assert result.hearing.told in result.reasons


@pytest.mark.parametrize("count", [3, 5])
def test_right_clicks_are_believed_and_sure_enough(count):
    result = told(UNDETERMINED, clicked(RIGHT[:count]))
    assert (
        result.verdict == "plausible" and result.confirmed and result.p_grave == CLICKED.p_supported
    )
    assert result.hearing is not None and all(result.hearing.accepted) and not result.hearing.told


@pytest.mark.parametrize("wrong", [3, 4])
def test_three_right_clicks_added_later_win_over_wrong_ones_that_fit_each_other(wrong):
    points = RIGHT[[0, 1, 3, 4]][:wrong]
    clicks = together(clicked(points, points + STEP), clicked(RIGHT[2:]))
    result = told(UNDETERMINED, clicks)
    assert np.allclose(result.T_i_j, T_TRUE, atol=0.05)
    assert result.hearing is not None
    assert result.hearing.accepted == (False,) * wrong + (True,) * 3


def test_where_images_say_nothing_what_more_clicks_say_counts_then_what_was_said_later():
    rng = np.random.default_rng(5)
    points = walls(rng, 70)
    views = tuple(
        prepare_view(view(rng, name, points, descriptors(rng, 70), inverse(T)))
        for name, T in (("r1", np.eye(4)), ("r2", T_TRUE))
    )
    one, other = RIGHT[:3], RIGHT[2:]
    hearing = heard(together(clicked(one, one + STEP), clicked(other)), views)
    assert (
        hearing.accepted == (False,) * 3 + (True,) * 3 and hearing.p_grave == CLICKED.p_unsupported
    )
    hearing = heard(together(clicked(other), clicked(one, one + STEP)), views)
    assert hearing.accepted == (False,) * 3 + (True,) * 3


def test_four_corners_of_a_window_in_any_other_order_are_refused_and_the_order_is_named():
    corners = np.array([[-2.0, -2, 10], [2, -2, 10], [2, 2, 10], [-2, 2, 10]])
    right = clicked(corners)
    named = 0
    for order in list(permutations(range(4)))[1:]:
        some = list(order)
        clicks = replace(right, uv_j=right.uv_j[some], z_j=right.z_j[some])
        result = told(UNDETERMINED, clicks)
        assert not result.confirmed, order
        assert result.hearing is None or result.hearing.p_grave == 1.0
        named += result.hearing is not None and "another order" in result.hearing.told
    assert named >= 3  # a square fits itself turned by a quarter and over


def test_a_view_upside_down_is_named_where_gravity_is_known():
    up = np.array([0.0, -1.0, 0.0])
    upright = tuple(replace(one, up=up) for one in VIEWS)
    half_turn = make_pose(exp_so3(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    said = hear(Pair(*upright, PAIR.ratio), T_TRUE @ half_turn)
    assert said.says == "against" and "r2 upside down: another order?" in said.why
    assert hear(Pair(*upright, PAIR.ratio), T_TRUE).says == "for"


def test_what_features_found_stands_where_images_contradict_the_clicks():
    plausible = PairResult(T_TRUE, np.eye(6), "plausible", ("some",), inliers=30, start="features")
    result = told(plausible, clicked(RIGHT, RIGHT + STEP))
    assert result.T_i_j is T_TRUE and result.verdict == "plausible" and not result.confirmed
    assert result.hearing is not None and not any(result.hearing.accepted)


def test_clicks_and_images_that_fit_two_poses_join_nothing_until_more_is_known():
    """From where the clicks put it, the second view sees next to nothing that the first one sees:
    the images cannot contradict it, but they are for the pose that features found.
    """
    aside = T_TRUE @ make_pose(exp_so3(np.array([0.0, np.radians(50.0), 0.0])), np.zeros(3))
    assert hear(Pair(*VIEWS, PAIR.ratio), aside).says == "blank"
    plausible = PairResult(T_TRUE, np.eye(6), "plausible", ("some",), inliers=30, start="features")
    result = told(plausible, clicked(RIGHT, T_i_j=aside))
    assert result.verdict == "ambiguous" and not result.confirmed
    assert np.allclose(result.T_i_j, T_TRUE) and np.allclose(result.rivals[0], aside, atol=0.05)
    assert result.hearing is not None and "More points decide" in result.hearing.told


def two_alike(unique: int):
    """Two views, 10 deg apart, of a place that is its own image after half a turn about what is
    upright in its middle, but for some things that exist once; the twin of their pose, what
    repeats and what does not.
    """
    rng = np.random.default_rng(7)
    half, looks = walls(rng, 500), descriptors(rng, 500)
    turn = make_pose(np.diag([-1.0, 1.0, -1.0]), np.array([0.0, 0.0, 20.0]))
    things = np.column_stack((rng.uniform(-3, 3, (unique, 2)), np.full(unique, 8.0)))
    points = np.concatenate((half, transform(turn, half), things))
    looks = np.concatenate((looks, looks, descriptors(rng, unique)))
    messages = (
        view(rng, "r1", points, looks, np.eye(4)),
        view(rng, "r2", points, looks, inverse(turned(10))),
    )
    return tuple(prepare_view(m) for m in messages), turn @ turned(10), half, things


def test_clicks_on_what_repeats_break_no_tie_and_one_on_what_exists_once_does():
    views, twin, half, things = two_alike(6)
    T = turned(10)
    tied = PairResult(T, np.eye(6), "ambiguous", ("2 poses",), rivals=(twin,), start="features")
    unique = told(tied, clicked(things[:4], T_i_j=T), views)
    assert unique.verdict == "plausible" and unique.confirmed and unique.rivals == ()
    middle = half[np.argsort(np.abs(half[:, :2]).sum(axis=1))[:200:50]]
    repeats = told(tied, clicked(middle, T_i_j=T), views)
    assert repeats.verdict == "ambiguous"
    assert repeats.hearing is not None and "exists only once" in repeats.hearing.told


def test_the_job_of_a_pair_tells_what_became_of_its_clicks():
    encoded = [EncodedView(message.name, pack(message)) for message in MESSAGES]
    wrong = clicked(RIGHT[:4], RIGHT[:4] + STEP)
    result = run_job(ClickJob(*encoded, features=False, clicks=wrong))
    assert not result.confirmed and result.hearing is not None
    assert not any(result.hearing.accepted) and result.hearing.told
    again = together(wrong, clicked(RIGHT[2:]))
    result = run_job(ClickJob(*encoded, features=False, clicks=again))
    assert result.hearing is not None
    assert result.hearing.accepted == (False,) * 4 + (True,) * 3


def test_one_of_five_right_clicks_that_is_a_little_off_makes_a_verified_pose_no_less_sure():
    right = clicked(RIGHT)
    slip = np.zeros((5, 2))
    slip[2] = 9.0
    off = replace(right, uv_j=right.uv_j + slip)
    verified = PairResult(T_TRUE, np.eye(6), "verified", ("many matches",), 200, start="graph")
    result = told(verified, off)
    assert result.verdict == "verified" and result.confirmed
    assert result.hearing is not None and not result.hearing.told
    assert sum(result.hearing.accepted) >= 4


def test_clicks_that_images_like_better_than_a_verified_alias_are_heard():
    """An alias was verified, of which the images find next to nothing again."""
    alias = T_TRUE.copy()
    alias[0, 3] += 3.0
    verified = PairResult(alias, np.eye(6), "verified", ("14 matches",), 14, start="features")
    result = told(verified, clicked(RIGHT))
    assert np.allclose(result.T_i_j, T_TRUE, atol=0.05) and result.confirmed
    assert result.verdict == "plausible"
    wrong = told(replace(verified, T_i_j=T_TRUE), clicked(RIGHT, RIGHT + STEP))
    assert wrong.T_i_j is T_TRUE and wrong.verdict == "verified" and not wrong.confirmed


def test_clicks_that_images_like_as_well_as_a_verified_pose_leave_it_ambiguous():
    views, twin, _, things = two_alike(6)
    verified = PairResult(twin, np.eye(6), "verified", ("many matches",), 200, start="features")
    result = told(verified, clicked(things[:4], T_i_j=turned(10)), views)
    assert result.verdict == "ambiguous" and not result.confirmed
    assert any(np.allclose(T, turned(10), atol=0.2) for T in (result.T_i_j, *result.rivals))
