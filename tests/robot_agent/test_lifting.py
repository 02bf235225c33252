"""Depth at salient points: right on surfaces, never across an edge, and with an honest sigma."""

import numpy as np
import pytest

from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, ScatteredPoints
from fleetpose.robot_agent.features.inverse_depth import lift_points, sigma_of

WIDTH, HEIGHT = 160, 120
K = np.array([[300.0, 0.0, 80.0], [0.0, 300.0, 60.0], [0.0, 0.0, 1.0]])
MODEL = Camera(
    width=WIDTH,
    height=HEIGHT,
    K=K,
    T_robot_camera=ROBOT_FROM_CAMERA,
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001)),
    kind="rgbd",
)
ROWS, COLUMNS = np.mgrid[0:HEIGHT, 0:WIDTH]


def inverse_depth_of_plane(u, v):
    """A wall seen at a slant: 0.35 to 0.65 1/m across the image."""
    return 0.5 + 0.0015 * (u - 80) - 0.0005 * (v - 60)


def places(count=400, seed=0, margin=6):
    rng = np.random.default_rng(seed)
    return rng.uniform((margin, margin), (WIDTH - 1 - margin, HEIGHT - 1 - margin), (count, 2))


def plane_image():
    return DepthImage((1 / inverse_depth_of_plane(COLUMNS, ROWS)).astype(np.float32))


def plane_disparity():
    disparity = 40.0 * inverse_depth_of_plane(COLUMNS, ROWS)
    return DisparityImage(disparity.astype(np.float32), focal_baseline_px_m=40.0)


def plane_points(count=15_000):
    uv = np.random.default_rng(1).uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (count, 2))
    return ScatteredPoints(uv, 1 / inverse_depth_of_plane(uv[:, 0], uv[:, 1]))


def half_image():
    u, v = np.meshgrid(2 * np.arange(80) + 0.5, 2 * np.arange(60) + 0.5)
    return DepthImage((1 / inverse_depth_of_plane(u, v)).astype(np.float32))


@pytest.mark.parametrize("ranges", [plane_image(), plane_disparity(), plane_points(), half_image()])
def test_depth_on_a_slanted_plane_is_that_of_the_plane(ranges):
    uv = places()
    lifted = lift_points(uv, ranges, MODEL)
    true = inverse_depth_of_plane(uv[:, 0], uv[:, 1])
    assert np.isfinite(lifted.inverse_depth).all()
    error = np.abs(lifted.inverse_depth - true)
    assert (error / true).max() < 2e-3
    assert (error / lifted.sigma).max() < 0.5


def step_image(near_m=1.0, far_m=1.5, edge=80):
    return np.where(edge > COLUMNS, near_m, far_m).astype(np.float32)


@pytest.mark.parametrize(("near_m", "far_m"), [(1.0, 1.5), (1.0, 1.05), (3.0, 2.0)])
def test_no_depth_lies_between_the_two_sides_of_an_edge(near_m, far_m):
    uv = places(2000)
    uv[:1000, 0] = np.random.default_rng(2).uniform(76, 84, 1000)
    lifted = lift_points(uv, DepthImage(step_image(near_m, far_m)), MODEL)
    expected = np.where(np.rint(uv[:, 0]) < 80, near_m, far_m)
    assert np.allclose(1 / lifted.inverse_depth, expected, rtol=1e-5)


def test_no_scattered_depth_lies_between_the_two_sides_of_an_edge():
    rng = np.random.default_rng(3)
    cloud = rng.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (15_000, 2))
    ranges = ScatteredPoints(cloud, np.where(cloud[:, 0] < 80, 1.0, 1.5))
    uv = places(2000)
    uv[:1000, 0] = rng.uniform(76, 84, 1000)
    depth = 1 / lift_points(uv, ranges, MODEL).inverse_depth
    known = np.isfinite(depth)
    assert known.mean() > 0.9
    assert (np.isclose(depth, 1.0, rtol=1e-5) | np.isclose(depth, 1.5, rtol=1e-5))[known].all()
    away = known & (np.abs(uv[:, 0] - 80) > 2)
    assert np.allclose(depth[away], np.where(uv[away, 0] < 80, 1.0, 1.5), rtol=1e-5)


def test_a_point_without_depth_of_its_own_gets_none_at_an_edge():
    depth = step_image()
    depth[60, 80] = np.nan  # at the edge
    depth[60, 40] = np.nan  # in the middle of a surface
    lifted = lift_points(np.array([[80.0, 60.0], [40.0, 60.0]]), DepthImage(depth), MODEL)
    assert np.isnan(lifted.inverse_depth[0])
    assert np.isnan(lifted.sigma[0])
    assert lifted.inverse_depth[1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    "ranges",
    [
        DepthImage(np.full((HEIGHT, WIDTH), np.nan, np.float32)),
        DepthImage(np.zeros((HEIGHT, WIDTH), np.float32)),
        DisparityImage(np.full((HEIGHT, WIDTH), -1.0, np.float32), 40.0),
        ScatteredPoints(np.zeros((0, 2)), np.zeros(0)),
        ScatteredPoints(np.array([[1.0, 1.0]]), np.array([1.0])),
    ],
)
def test_far_from_any_measurement_there_is_no_depth(ranges):
    lifted = lift_points(places(50, margin=20), ranges, MODEL)
    assert np.isnan(lifted.inverse_depth).all()
    assert np.isnan(lifted.sigma).all()


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_a_few_scattered_points_suffice(count):
    uv = np.column_stack((20.0 + 30 * np.arange(count), np.full(count, 50.0)))
    lifted = lift_points(uv, ScatteredPoints(uv, np.full(count, 2.0)), MODEL)
    assert np.allclose(lifted.inverse_depth, 0.5)


def test_no_points_to_lift_are_no_points_lifted():
    for ranges in (plane_image(), plane_points()):
        assert lift_points(np.zeros((0, 2)), ranges, MODEL).inverse_depth.shape == (0,)


def test_the_image_border_is_no_obstacle():
    uv = np.array([[2.0, 2.0], [WIDTH - 3.0, HEIGHT - 3.0], [2.0, HEIGHT - 3.0]])
    lifted = lift_points(uv, plane_image(), MODEL)
    assert np.allclose(lifted.inverse_depth, inverse_depth_of_plane(*uv.T), rtol=1e-3)


def test_sigma_is_that_of_one_measurement_at_least():
    uv = places()
    for ranges in (plane_image(), plane_points()):
        lifted = lift_points(uv, ranges, MODEL)
        assert (lifted.sigma >= sigma_of(lifted.inverse_depth, MODEL) * 0.999).all()


def test_sigma_covers_what_extrapolation_misses():
    depth = np.asarray(plane_image().depth_m).copy()
    depth[:, 80:] = np.nan
    uv = np.array([[60.0, 60.0], [80.4, 60.0], [81.4, 60.0]])  # amid, beside, further beside
    lifted = lift_points(uv, DepthImage(depth), MODEL)
    error = np.abs(lifted.inverse_depth - inverse_depth_of_plane(*uv.T))
    assert (error < lifted.sigma).all()
    assert lifted.sigma[2] > 2 * lifted.sigma[0]


def test_sigma_is_honest_under_the_stated_noise():
    rng = np.random.default_rng(4)
    uv = rng.uniform((0, 0), (WIDTH - 1, HEIGHT - 1), (400, 2))  # sparse: mostly one neighbour
    true = inverse_depth_of_plane(uv[:, 0], uv[:, 1])
    measured = true + rng.normal(size=400) * sigma_of(true, MODEL)
    lifted = lift_points(uv, ScatteredPoints(uv, 1 / measured), MODEL)
    normalised = (lifted.inverse_depth - true) / lifted.sigma
    assert 0.5 < np.sqrt(np.nanmean(normalised**2)) < 1.3
