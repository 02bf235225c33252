"""Points that are told apart by the surface around them, and poses of which both matches and
surfaces know something.
"""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server.geometry.features.matching import ratio_matches
from fleetpose.pose_server.geometry.features.shapes import shapes_of
from fleetpose.pose_server.geometry.icp import dense_cloud, gicp
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform, weighted_mean
from fleetpose.pose_server.registration.align import align_pair, align_wide
from fleetpose.pose_server.registration.prepared_view import MeasuredCloud, prepare_view
from tests.pose_server.scene import pair_of_views


def wall_with_roofs(rng, count=60_000):
    """Points (N, 3) on a slanted wall with pyramids on its right half, seen from the origin."""
    x, y = rng.uniform(-1.5, 1.5, count), rng.uniform(-1.2, 1.2, count)
    z = 3.0 + 0.2 * x
    for cx, cy, size, height in (
        (0.5, 0.5, 0.5, 0.5),
        (1.0, -0.5, 0.4, 0.25),
        (0.3, -0.6, 0.25, 0.3),
    ):
        far = np.maximum(np.abs(x - cx), np.abs(y - cy)) / size
        z = z - height * np.maximum(0.0, 1.0 - far)
    return np.column_stack((x, y, z + 0.001 * rng.normal(size=count)))


def turned(degrees):
    R = exp_so3(np.radians(degrees) * np.array([0.3, 0.9, 0.1]) / np.linalg.norm([0.3, 0.9, 0.1]))
    centre = np.array([0.0, 0.0, 3.0])
    return make_pose(R, centre - R @ centre)


def test_the_same_places_look_alike_from_elsewhere():
    points = wall_with_roofs(np.random.default_rng(0))
    T = turned(25)
    here = shapes_of(points, 0.06)
    there = shapes_of(transform(inverse(T), wall_with_roofs(np.random.default_rng(1))), 0.06)
    matches, _ = ratio_matches(here.descriptors, there.descriptors, 1.0)
    off = np.linalg.norm(
        transform(T, there.points[matches[:, 1]]) - here.points[matches[:, 0]], axis=1
    )
    by_chance = np.mean(
        np.linalg.norm(transform(T, there.points)[:, None] - here.points[None], axis=2) < 0.15
    )
    assert np.mean(off < 0.15) > 10 * by_chance


def test_bent_places_are_chosen_not_flat_ones():
    points = wall_with_roofs(np.random.default_rng(0), 200_000)
    shapes = shapes_of(points, 0.05)
    assert np.mean(shapes.points[:, 0] > -0.2) > 0.9


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_shapes_do_not_depend_on_the_unit(scale):
    points = wall_with_roofs(np.random.default_rng(0), 5_000)
    one, other = shapes_of(points, 0.1), shapes_of(scale * points, scale * 0.1)
    assert len(one.points) == len(other.points)
    cosines = np.sort((one.descriptors @ other.descriptors.T).max(axis=1))
    assert cosines[len(cosines) // 10] > 0.99


@pytest.mark.parametrize(
    "points",
    [
        np.array([[0.0, 0.0, 1.0]]),
        np.tile([[0.1, 0.2, 1.0]], (50, 1)),
        np.column_stack((np.linspace(0, 1, 50), np.zeros(50), np.ones(50))),
        np.column_stack((np.tile(np.arange(8.0), 8), np.repeat(np.arange(8.0), 8), np.ones(64))),
    ],
    ids=["one", "coincident", "line", "plane"],
)
def test_poor_clouds_have_shapes_of_finite_numbers(points):
    shapes = shapes_of(points, 0.5)
    assert np.isfinite(shapes.descriptors).all()
    assert np.isfinite(shapes.points).all()


def test_a_joint_fit_is_where_both_pull_it():
    T_a, T_b = turned(0), turned(2)
    some = np.diag([4.0, 4.0, 4.0, 1.0, 1.0, 1.0])
    nothing = np.zeros((6, 6))
    np.testing.assert_allclose(weighted_mean(T_a, some, T_b, nothing), T_a, atol=1e-12)
    np.testing.assert_allclose(weighted_mean(T_a, nothing, T_b, some), T_b, atol=1e-9)
    np.testing.assert_allclose(weighted_mean(T_a, nothing, T_b, nothing), T_a, atol=1e-12)
    middle = weighted_mean(T_a, some, T_b, some)
    to_a, to_b = (np.linalg.norm(middle[:3] - T[:3]) for T in (T_a, T_b))
    assert abs(to_a - to_b) < 0.05 * to_a
    np.testing.assert_allclose(middle[:3, :3] @ middle[:3, :3].T, np.eye(3), atol=1e-9)


def test_surfaces_say_which_way_they_can_slide():
    """On a plane that faces the camera nothing tells x, y and the turn about the axis."""
    rng = np.random.default_rng(0)
    plane = np.column_stack((rng.uniform(-1, 1, (20_000, 2)), np.full(20_000, 2.0)))
    plane[:, 2] += 0.002 * rng.normal(size=len(plane))
    cloud = dense_cloud(plane, 0.06)
    fit = gicp(cloud, cloud, np.eye(4), 0.2)
    known = np.diag(fit.hessian)
    assert known[5] > 20 * max(known[3], known[4])  # z against x and y
    assert min(known[0], known[1]) > 20 * known[2]  # tilts against the turn about z


def test_dense_clouds_without_any_shape_or_match_are_rejected_with_a_reason():
    """Both clouds lie on one spot and no salient point looks alike: nothing is left to try."""
    views = []
    for seed, message in enumerate(pair_of_views(np.random.default_rng(0), turned(10))):
        view = prepare_view(message)
        none = np.zeros((0, 128), np.float32)
        observed = replace(
            view.observed,
            uv=np.zeros((0, 2)),
            inverse_depth=np.zeros(0),
            inverse_depth_sigma=np.zeros(0),
        )
        spot = np.array([0.0, 0.0, 2.0]) + 1e-4 * np.random.default_rng(seed).normal(
            size=(12_000, 3)
        )
        measured = MeasuredCloud(spot, view.measured.resolution_m)
        views.append(replace(view, observed=observed, descriptors=none, measured=measured))
    i, j = views
    assert i.dense and j.dense
    result = align_wide(i, j, align_pair(i, j))
    assert result.verdict == "rejected" and result.reasons
