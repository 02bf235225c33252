"""Alignment of made-up views: found at any scale, never verified where nothing is in common."""

import dataclasses

import numpy as np
import pytest

from fleetpose.pose_server.geometry.features.free_space import agreement
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.clicked import with_clicks
from fleetpose.pose_server.registration.operator_starts import Clicks, operator_starts
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.refinement import Start
from fleetpose.pose_server.registration.verdict.evidence import NO_RIVAL, Evidence
from fleetpose.pose_server.registration.verdict.explained import Explained
from fleetpose.pose_server.registration.verdict.fitted_model import MODEL
from fleetpose.pose_server.registration.verdict.grave_probability import p_grave
from fleetpose.pose_server.registration.verdict.words import judge
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.clouds import decode_salient, encode_salient
from tests.pose_server.scene import descriptors, pair_of_views, turned, view, walls

GOOD = Evidence(
    inliers=100,
    exact=95,
    ratio_inliers=60,
    ratio_matches=80,
    rival=0,
    rivalled=60,
    position_sigma=0.002,
    rotation_sigma_rad=0.002,
    across_px=0.5,
    pixel_sigma_px=0.5,
    shift=0.001,
    turn_rad=0.001,
    pulled=0.001,
    compared=500,
    agree=0.9,
    through=0.01,
    spread=0.2,
    depth_noise=1.0,
    depth_sigma=0.01,
    lead=NO_RIVAL,
    explained=Explained(
        visible=300,
        share=0.32,
        unguided_share=0.8,
        holes=0.0,
        parallax_rad=0.4,
        scale=0.05,
        front=1.0,
        sides=100,
    ),
)


@pytest.mark.parametrize("depth_m", [0.1, 10.0, 1000.0])
def test_a_pair_is_found_and_verified_whatever_the_size_of_the_scene(depth_m):
    T_true = turned(15, depth_m)
    i, j = pair_of_views(np.random.default_rng(0), T_true, depth_m)
    found = align_pair(prepare_view(i), prepare_view(j))
    assert found.verdict == "verified"
    assert np.linalg.norm(found.T_i_j[:3, 3] - T_true[:3, 3]) < 0.01 * depth_m
    assert rotation_angle(found.T_i_j[:3, :3].T @ T_true[:3, :3]) < 0.01


@pytest.mark.parametrize("seed", range(6))
def test_views_with_nothing_in_common_are_never_verified(seed):
    rng = np.random.default_rng(seed)
    i = view(rng, "r1", walls(rng), descriptors(rng, 800), np.eye(4))
    j = view(rng, "r2", walls(rng), descriptors(rng, 800), np.eye(4))
    found = align_pair(prepare_view(i), prepare_view(j), (Start("graph", turned(5), 0.03),))
    assert found.verdict in ("rejected", "ambiguous")


def test_a_second_pose_with_as_many_matches_makes_it_ambiguous_or_worse():
    """Half of the points are seen where they are, half as if the scene stood three metres aside."""
    rng = np.random.default_rng(1)
    points, looks = walls(rng), descriptors(rng, 800)
    moved = points.copy()
    moved[::2, 0] += 3.0
    i = view(rng, "r1", points, looks, np.eye(4))
    j = view(rng, "r2", moved, looks, inverse(turned(5)))
    assert align_pair(prepare_view(i), prepare_view(j)).verdict != "verified"


def test_a_shifted_pose_is_seen_through_or_disagrees():
    T_true = turned(15)
    i, j = (prepare_view(v) for v in pair_of_views(np.random.default_rng(2), T_true))
    right = agreement(i.surface, j.surface, T_true)
    assert right.agree > 0.8 and right.through < 0.05
    for direction in np.eye(3):
        T = T_true.copy()
        T[:3, 3] += 1.5 * direction * np.array([1.0, 1.0, 1.0])
        wrong = agreement(i.surface, j.surface, T)
        assert wrong.agree < right.agree


SURE = 1e-3  # the probability of a grave error that goes with evidence like this


@pytest.mark.parametrize(
    "change",
    [
        {"exact": 12},
        {"position_sigma": 0.02},
        {"rotation_sigma_rad": 0.05},
        {"shift": 0.02},
        {"compared": 5},
        {"lead": 2.0},
    ],
)
def test_each_doubt_alone_keeps_a_pose_from_being_verified(change):
    assert judge(GOOD, SURE)[0] == "verified"
    verdict, reasons = judge(dataclasses.replace(GOOD, **change), SURE)
    assert verdict != "verified"
    assert reasons and all(reasons)


@pytest.mark.parametrize(
    "change", [{"inliers": 3}, {"through": 0.4}, {"agree": 0.1}, {"position_sigma": 0.5}]
)
def test_each_contradiction_alone_rejects(change):
    assert judge(dataclasses.replace(GOOD, **change), SURE)[0] == "rejected"


def test_what_would_be_seen_from_behind_is_rejected():
    behind = dataclasses.replace(GOOD.explained, front=0.05)
    verdict, reasons = judge(dataclasses.replace(GOOD, explained=behind), SURE)
    assert verdict == "rejected" and "behind" in reasons[0]


def test_the_words_are_limits_on_the_probability():
    verdicts = [judge(GOOD, p)[0] for p in (0.001, 0.05, 0.99)]
    assert verdicts == ["verified", "plausible", "rejected"]


@pytest.mark.parametrize(
    "worse",
    [
        {"exact": 55},
        {"depth_noise": 2.5},
        {"through": 0.2},
        {"position_sigma": 0.02},
        {"share": 0.05},
        {"front": 0.3},
    ],
)
def test_each_sign_of_an_alias_makes_a_grave_error_likelier(worse):
    parts = {k: v for k, v in worse.items() if hasattr(GOOD.explained, k)}
    rest = {k: v for k, v in worse.items() if k not in parts}
    explained = dataclasses.replace(GOOD.explained, **parts)
    changed = dataclasses.replace(GOOD, explained=explained, **rest)
    assert p_grave(changed, MODEL) > 1.2 * p_grave(GOOD, MODEL)


def clicks_of(T_i_j: np.ndarray, points: np.ndarray, K: np.ndarray, sigma_m: float) -> Clicks:
    at_j = (points - T_i_j[:3, 3]) @ T_i_j[:3, :3]
    uv_i, uv_j = ((p @ K.T)[:, :2] / p[:, 2:] for p in (points, at_j))
    sigma = np.full(len(points), sigma_m)
    return Clicks(uv_i, uv_j, points[:, 2], at_j[:, 2], sigma, sigma)


FAR_APART = np.array([[-3.0, -2.0, 9.0], [3.0, -2.0, 11.0], [0.0, 2.5, 10.0]])


def test_three_clicks_give_a_start_that_alignment_confirms():
    T_true = turned(30)
    i, j = (prepare_view(v) for v in pair_of_views(np.random.default_rng(3), T_true))
    clicks = clicks_of(T_true, FAR_APART, i.observed.K, 0.1)
    (start,) = operator_starts(i, j, clicks, ())
    assert start.model == "rigid"
    assert np.allclose(start.start.T_i_j, T_true, atol=1e-3)
    found = align_pair(i, j, [start.start], features=False)
    assert (found.verdict, found.start) == ("verified", "operator")


def test_one_click_takes_its_rotation_from_elsewhere():
    i, j = (prepare_view(v) for v in pair_of_views(np.random.default_rng(4), turned(10)))
    clicks = clicks_of(turned(10), FAR_APART[:1], i.observed.K, 0.1)
    known = Start("graph", turned(10), 0.02)
    (start,) = operator_starts(i, j, clicks, (known,))
    assert start.model == "translation" and start.covariance is None
    assert np.allclose(start.linear[:3, :3], turned(10)[:3, :3])
    (start,) = operator_starts(i, j, clicks, ())
    assert start.start.sigma > known.sigma and np.array_equal(start.linear[:3, :3], np.eye(3))


@pytest.mark.parametrize(("count", "locates"), [(70, False), (35, True)])
def test_clicks_alone_are_plausible_where_features_say_nothing_but_never_verified(count, locates):
    """Two views with few salient points, which look like nothing in the other one."""
    rng = np.random.default_rng(5)
    points = walls(rng, count)
    i = prepare_view(view(rng, "r1", points, descriptors(rng, count), np.eye(4)))
    j = prepare_view(view(rng, "r2", points, descriptors(rng, count), inverse(turned(10))))
    clicks = clicks_of(turned(10), FAR_APART, i.observed.K, 0.1)
    sets = operator_starts(i, j, clicks, ())
    found = with_clicks(align_pair(i, j, [sets[0].start], False), sets, clicks, i, j)
    assert found.verdict == "plausible"
    assert found.start == "operator"
    assert found.hearing is not None and "neither confirm nor contradict" in found.hearing.told
    limit = ServerSettings.model_validate({}).located_grave
    assert (found.p_grave < limit) is locates


def test_depths_that_are_all_too_long_do_not_bend_a_pose_that_the_images_know():
    """One view's depths are 12 % too long, ten times their stated sigma and the same for all."""
    errors_deg = []
    for seed in range(12):
        T_true = turned(20 if seed % 2 else 40)
        i, j = pair_of_views(np.random.default_rng(seed), T_true)
        points = decode_salient(j.salient)
        long = dataclasses.replace(points, inverse_depth=points.inverse_depth / np.float32(1.12))
        j = j.model_copy(update={"salient": encode_salient(long)})
        result = align_pair(prepare_view(i), prepare_view(j))
        assert result.T_i_j is not None
        R_error = T_true[:3, :3].T @ result.T_i_j[:3, :3]
        errors_deg.append(np.degrees(rotation_angle(R_error)))
    assert np.median(errors_deg) < 0.18
