"""What pairs of views tell of calibrations: truths, properties, and no alarm from noise."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.calibration import monitor
from fleetpose.pose_server.calibration.depth_comparison import DepthErrors, compare_depths
from fleetpose.pose_server.calibration.findings import bend_of, time_offset, wrong_scales
from fleetpose.pose_server.calibration.history import (
    KEPT_PER_PAIR,
    MAX_PARTNERS,
    DepthHistory,
    DepthStatement,
)
from fleetpose.pose_server.calibration.resection import resection, three_point_poses
from fleetpose.pose_server.geometry.features.observed import Observed
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, rotation_angle
from fleetpose.pose_server.state.site import Site
from tests.pose_server.scene import SIZE, K, observed_pair, turned
from tests.pose_server.test_flows import Forgetful

T_I_J = turned(35.0)
COUNT = 150
MATCHES = np.column_stack((np.arange(COUNT), np.arange(COUNT)))
FOCAL_BASELINE = 270.0


def scaled(view: Observed, k: float) -> Observed:
    """The same view with depths k times as long."""
    return replace(view, inverse_depth=view.inverse_depth / k)


def bent(view: Observed, bend: tuple[float, float, float]) -> Observed:
    """The same view with inverse depths that are off, 1/m."""
    half = 0.5 * (np.array(view.size) - 1)
    x = (view.uv[:, 0] - K[0, 2]) / K[0, 0]
    shape = np.column_stack((1 + x**2, view.uv / half - 1))
    return replace(view, inverse_depth=view.inverse_depth + shape @ np.array(bend))


def compared(i: Observed, j: Observed, T_i_j=None) -> DepthErrors:
    found = compare_depths(i, j, MATCHES, T_i_j)
    assert found is not None
    return found


def test_three_points_and_their_rays_give_the_true_pose():
    rng = np.random.default_rng(0)
    R, t = exp_so3(rng.normal(size=3)), np.array([0.3, -0.2, 0.5])
    seen = rng.uniform(-3, 3, (40, 3, 3)) + np.array([0.0, 0.0, 9.0])
    points = (seen - t) @ R
    rays = seen / np.linalg.norm(seen, axis=2, keepdims=True)
    rotations, translations = three_point_poses(points, rays)
    near = (np.abs(rotations - R).max(axis=(1, 2)) < 1e-5) & (
        np.abs(translations - t).max(axis=1) < 1e-4
    )
    assert near.sum() >= 38


def test_pixels_find_the_pose_without_the_depths_of_the_target():
    rng = np.random.default_rng(1)
    i, j = observed_pair(rng, T_I_J, COUNT)
    matches = MATCHES.copy()
    matches[::2, 0] = rng.permutation(matches[::2, 0])  # alike many of the more similar ones
    found = resection(j, scaled(i, 3.0), matches[:, ::-1])
    assert found is not None
    T, agrees = found
    assert rotation_angle(T[:3, :3].T @ T_I_J[:3, :3]) < 0.03
    assert agrees[1::2].mean() > 0.5 and agrees[::2].mean() < 0.1


@settings(max_examples=15, deadline=None)
@given(st.floats(0.8, 1.25), st.integers(0, 10_000))
def test_a_scaled_view_gives_its_scale_within_its_sigma(k, seed):
    i, j = observed_pair(np.random.default_rng(seed), T_I_J, COUNT)
    found = compared(i, scaled(j, k))
    assert abs(found.scale - np.log(k)) < 5 * found.scale_sigma
    assert found.scale_sigma < 0.01


@pytest.mark.parametrize(
    "bend", [(0.06, 0.0, 0.0), (-0.04, 0.0, 0.0), (0.0, 0.0, 0.03), (0.02, -0.02, 0.02)]
)
def test_a_bend_is_found_in_the_view_that_has_it_and_not_in_the_other(bend):
    i, j = observed_pair(np.random.default_rng(2), T_I_J, COUNT)
    found = compared(bent(i, bend), j)
    sigma_i, sigma_j = (np.sqrt(np.diag(C)) for C in (found.covariance_i, found.covariance_j))
    assert np.abs(found.bend_i - bend).max() < 0.006
    assert (np.abs(found.bend_i - bend) < 5 * sigma_i).all()
    assert (np.abs(found.bend_j) < 5 * sigma_j).all()


def test_the_order_of_the_views_does_not_matter():
    i, j = observed_pair(np.random.default_rng(3), T_I_J, COUNT)
    j = scaled(j, 1.07)
    there = compared(i, j, T_I_J)
    back = compare_depths(j, i, MATCHES, inverse(T_I_J))
    assert back is not None
    assert back.scale == pytest.approx(-there.scale, abs=2 * there.scale_sigma)
    assert back.swapped().bend_i == pytest.approx(back.bend_j)


def test_views_of_different_things_say_nothing():
    rng = np.random.default_rng(4)
    i, j = observed_pair(rng, T_I_J, COUNT)
    shuffled = MATCHES.copy()
    shuffled[:, 0] = rng.permutation(COUNT)
    assert compare_depths(i, j, shuffled, None) is None
    assert compare_depths(i, j, MATCHES[:10], None) is None


def pairs_among(rng, robots: int, wrong: dict[str, float], sigma=0.005):
    """What all pairs of r1, r2, ... say of their scales."""
    names = [f"r{k + 1}" for k in range(robots)]
    return {
        (a, b): (wrong.get(a, 0.0) - wrong.get(b, 0.0) + rng.normal(0, sigma), sigma)
        for k, a in enumerate(names)
        for b in names[k + 1 :]
    }


@pytest.mark.parametrize("who", ["r1", "r2", "r3", "r4"])
@pytest.mark.parametrize("scale", [0.05, -0.05])
def test_the_robot_of_four_that_differs_from_all_is_named(who, scale):
    found = wrong_scales(pairs_among(np.random.default_rng(5), 4, {who: scale}, 0.003))
    assert list(found.wrong) == [who] and not found.undecided
    estimate = found.wrong[who]
    assert abs(estimate.value - scale) < 3 * estimate.sigma and estimate.partners == 3


def test_noise_alone_raises_no_alarm():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        found = wrong_scales(pairs_among(rng, 2 + seed % 6, {}, 0.007))
        assert not found.wrong and not found.undecided
        covariance = np.diag([4e-6, 1e-6, 1e-6])
        said = {
            f"r{k}": (rng.multivariate_normal(np.zeros(3), covariance), covariance)
            for k in range(2 + seed % 5)
        }
        assert bend_of(said, 0.1, 0.1) is None
        rates = rng.normal(0, 0.1, 12)
        assert time_offset(rng.normal(0, 0.007, 12), np.full(12, 0.004), rates) is None


def test_of_two_robots_neither_is_named_and_both_are_told():
    found = wrong_scales({("r1", "r2"): (0.08, 0.004)})
    assert not found.wrong and list(found.undecided) == [("r1", "r2")]


def test_one_partner_is_enough_if_others_vouch_for_it():
    rng = np.random.default_rng(6)
    pairs = pairs_among(rng, 3, {}, 0.003) | {("r1", "r9"): (-0.09, 0.004)}
    assert list(wrong_scales(pairs).wrong) == ["r9"]


def test_two_against_two_is_not_decided():
    pairs = pairs_among(np.random.default_rng(7), 4, {"r1": 0.08, "r2": 0.08}, 0.003)
    found = wrong_scales(pairs)
    assert not found.wrong and len(found.undecided) == 4


def test_a_pair_that_matched_two_copies_of_something_is_no_alarm():
    pairs = pairs_among(np.random.default_rng(8), 5, {}, 0.003)
    pairs["r1", "r4"] = (0.3, 0.004)
    found = wrong_scales(pairs)
    assert not found.wrong and not found.undecided


def test_a_clock_offset_is_what_changes_with_the_pace():
    rng = np.random.default_rng(9)
    rates = rng.uniform(-0.4, 0.4, 40)
    scales = 0.02 - 0.1 * rates + rng.normal(0, 0.004, 40)
    found = time_offset(scales, np.full(40, 0.004), rates)
    assert found is not None
    assert abs(found.value - 0.1) < 3 * found.sigma < 0.06
    assert time_offset(scales, np.full(40, 0.004), np.zeros(40)) is None


def test_memory_is_bounded_and_forgets():
    i, j = observed_pair(np.random.default_rng(10), T_I_J, COUNT)
    said = DepthStatement(compared(i, scaled(j, 1.1), T_I_J), 0.1, float("nan"))
    memory = DepthHistory()
    for k in range(MAX_PARTNERS + 5):
        for _ in range(KEPT_PER_PAIR + 3):
            memory.note(f"p{k}", "r1", said)
    assert len(memory.scales(set())) == MAX_PARTNERS
    assert len(memory.paces("p20")[0]) == KEPT_PER_PAIR and not len(memory.paces("r1")[0])
    value, _ = memory.scales(set())["p20", "r1"]
    assert value == pytest.approx(-said.errors.scale)
    memory.forget("r1")
    assert not memory.robots


def site_with(errors: dict[str, object], stereo: bool = True) -> Site:
    """Four robots around a scene, their depths as given by name of the robot, all compared."""
    rng = np.random.default_rng(11)
    site = Site(Forgetful())  # pyright: ignore[reportArgumentType]  the book is not asked
    camera = SimpleNamespace(
        K=K,
        height=SIZE[1],
        noise=SimpleNamespace(focal_baseline_px_m=FOCAL_BASELINE if stereo else None),
    )
    names = ("r1", "r2", "r3", "r4")
    for name in names:
        site.robot(name).camera = camera  # pyright: ignore[reportAttributeAccessIssue]
    for k, a in enumerate(names):
        for b in names[k + 1 :]:
            i, j = observed_pair(rng, turned(25.0), COUNT)
            i, j = (errors.get(n, lambda v: v)(v) for n, v in ((a, i), (b, j)))  # pyright: ignore
            site.depths.note(a, b, DepthStatement(compared(i, j), float("nan"), float("nan")))
    monitor.judge_calibrations(site)
    return site


def test_the_alarm_names_the_robot_the_percentage_and_what_to_do():
    site = site_with({"r3": lambda view: scaled(view, 1.05)})
    assert [(a.robot, a.kind) for a in site.alarms.standing] == [("r3", "scale")]
    text = site.alarms.standing[0].text
    assert text.startswith("r3's depths are ") and "too long against 3 partners" in text
    assert abs(float(text.split()[3]) - 5.0) < 1.0 and "calibrate-check" in text
    monitor.judge_calibrations(site)
    assert site.events == [text]


def test_a_turned_camera_is_named_with_its_angle():
    angle = np.radians(2.0)
    offset = K[0, 0] * np.tan(angle) / FOCAL_BASELINE
    site = site_with({"r2": lambda view: bent(view, (offset, 0.0, 0.0))})
    assert [(a.robot, a.kind) for a in site.alarms.standing] == [("r2", "bent")]
    assert (
        "turned by 2.0 deg" in site.alarms.standing[0].text
        or "turned by 1.9 deg" in site.alarms.standing[0].text
    )


def test_right_calibrations_raise_no_alarm_and_a_new_one_clears_it():
    assert not site_with({}).alarms.standing
    site = site_with({"r3": lambda view: scaled(view, 1.05)})
    site.depths.forget("r3")
    monitor.judge_calibrations(site)
    assert not site.alarms.standing
