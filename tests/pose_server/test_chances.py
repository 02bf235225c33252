"""How likely two images share something to click, by what aligning parts of the fleet left."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.questions.overlap_prior import (
    Attempt,
    Look,
    apart,
    log_odds,
    overlap_probabilities,
    overlap_probability,
)
from fleetpose.pose_server.registration.verdict.evidence import NO_RIVAL, Evidence
from fleetpose.pose_server.registration.verdict.explained import Explained
from tests.pose_server.fleet_makers import exp_se3, ring

K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
STEP_DEG = 15.0
WORLD = ring(24)
A, B = (0, 1, 2), (6, 7, 8)  # places on the ring; 1 and 8 are 105 degrees apart, 2 and 6 are 60
FAR = exp_se3(np.array([0.0, 2.5, 0.0, 1.0, 0.0, 2.0]))


def part(places):
    """Looks in the frame of the first."""
    return [Look(inverse(WORLD[places[0]]) @ WORLD[k], K, (640, 480), 3.0) for k in places]


def tried(a, b, odds, wrong=False, **more):
    T = inverse(WORLD[A[a]]) @ WORLD[B[b]]
    return Attempt(a, b, T @ FAR if wrong else T, odds, **more)


def others(*known):
    done = {(one.a, one.b) for one in known}
    rest = [Attempt(a, b, None, -6.0) for a in range(3) for b in range(3) if (a, b) not in done]
    return [*known, *rest]


def test_angle_and_share_are_those_of_the_views():
    share, angle = apart(part(A), part(B), inverse(WORLD[A[0]]) @ WORLD[B[0]])
    expected = [[STEP_DEG * (b - a) for b in B] for a in A]
    assert np.allclose(angle, expected, atol=1e-6)
    assert (share > 0.4).all()
    turned_away = np.eye(4)
    turned_away[:3, :3] = np.diag([-1.0, 1.0, -1.0])
    assert apart(part(A[:1]), part(A[:1]), turned_away)[0].item() == 0.0


def test_nearer_views_and_larger_shares_are_likelier():
    angles = np.array([10.0, 60.0, 85.0, 120.0])
    assert (np.diff(overlap_probability(np.ones(4), angles)) < 0).all()
    assert overlap_probability(np.array(0.3), np.array(60.0)) < overlap_probability(
        np.array(0.9), np.array(60.0)
    )


def test_pose_that_fits_points_at_the_nearest_pair_of_both_parts():
    table = overlap_probabilities(part(A), part(B), others(tried(0, 1, 2.0)))
    assert np.unravel_index(table.argmax(), table.shape) == (2, 0)


def test_poses_that_agree_outweigh_a_better_one_that_stands_alone():
    alone = tried(0, 2, 0.5, wrong=True)
    agreeing = [tried(2, 0, -0.5), tried(1, 0, -0.5), tried(2, 1, -0.5)]
    lonely = overlap_probabilities(part(A), part(B), others(alone, agreeing[0]))
    table = overlap_probabilities(part(A), part(B), others(alone, *agreeing))
    assert table[2, 0] > 0.6 and table[2, 0] > lonely[2, 0]


def test_hypothesis_loses_where_it_puts_unaligned_views_side_by_side():
    beside = Attempt(1, 1, exp_se3(np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0])), 1.0, otherwise=0.0)
    table = overlap_probabilities(part(A), part(B), others(beside))
    assert table[1, 1] < 0.1


@pytest.mark.parametrize("odds", [-3.0, 0.0, 3.0])
def test_looking_in_vain_makes_the_pairs_beside_less_likely_too(odds):
    before = overlap_probabilities(part(A), part(B), others(tried(1, 0, odds)))
    after = overlap_probabilities(
        part(A), part(B), others(tried(1, 0, odds), tried(2, 0, -6.0, in_vain=1))
    )
    assert (after <= before + 1e-9)[before > 0.2].all()
    assert after[1, 0] < before[1, 0] and after[2, 1] < before[2, 1]


def test_chances_are_probabilities_whatever_is_known():
    rng = np.random.default_rng(0)
    for _ in range(20):
        known = [
            tried(
                a, b, float(rng.normal(0, 4)), bool(rng.integers(2)), in_vain=int(rng.integers(3))
            )
            for a in range(3)
            for b in range(3)
        ]
        table = overlap_probabilities(part(A), part(B), known)
        assert ((table >= 0) & (table <= 1)).all()


def evidence(**more):
    stated = {
        "inliers": 60,
        "ratio_inliers": 14,
        "ratio_matches": 400,
        "rival": 0,
        "position_sigma": 0.03,
        "rotation_sigma_rad": 0.02,
        "across_px": 1.0,
        "pixel_sigma_px": 1.0,
        "shift": 0.0,
        "turn_rad": 0.0,
        "pulled": 0.0,
        "compared": 100,
        "agree": 0.6,
        "through": 0.0,
        "spread": 0.2,
        "depth_noise": 1.0,
        "depth_sigma": 0.01,
        "exact": 50,
        "rivalled": 14,
        "lead": NO_RIVAL,
        "explained": Explained(400, 0.12, 0.1, 0.0, 0.8, 0.1, 0.9, 60),
    }
    return Evidence(**{**stated, **more})


def test_odds_fall_with_residuals_and_sigma_and_rise_with_matches():
    usual = log_odds(evidence())
    assert log_odds(evidence(across_px=5.0)) < usual
    assert log_odds(evidence(position_sigma=0.09)) < usual
    assert log_odds(evidence(ratio_inliers=40)) > usual
    assert log_odds(None) < log_odds(evidence(across_px=8.0))


def test_points_of_a_sight_lie_before_the_camera():
    look = part(A)[0]
    places = transform(look.T_part_camera, look.sight)
    assert np.allclose(places[:, 2], 3.0)
