"""The simulated operator clicks what is truly the same point, with a hand's noise."""

import numpy as np
import pytest

from fleetpose.evaluation.metrics.geometry import inverse, transform
from fleetpose.evaluation.simulate.operator import by_depth, by_tracks, draw_clicks, far_apart
from tests.evaluation.makers import HEIGHT, WIDTH, K, pose

SIZES = ((WIDTH, HEIGHT), (WIDTH, HEIGHT))


def wall(z=2.0):
    """A dense wall (N, 3) and its pixels (N, 2) as a depth camera sees it."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    uv = np.column_stack((u.ravel(), v.ravel())).astype(float)
    rays = np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(K).T
    return rays * z, uv


def test_tracks_in_common_give_their_pixels_in_both_views():
    uv = np.arange(10.0).reshape(5, 2)
    pixels_i, pixels_j = by_tracks(np.array([7, 3, 9]), uv[:3], np.array([9, 1, 3]), uv[2:])
    assert pixels_i.tolist() == [uv[1].tolist(), uv[2].tolist()]
    assert pixels_j.tolist() == [uv[4].tolist(), uv[2].tolist()]


def test_by_depth_pixels_show_the_same_points():
    points_i, uv_i = wall()
    T_i_j = pose(0.0, (0.2, 0.0, 0.0))
    points_j, uv_j = points_i, uv_i  # the wall looks the same from beside
    found_i, found_j = by_depth(points_i, uv_i, points_j, uv_j, K, inverse(T_i_j))
    assert len(found_i) > 5000
    assert found_j - found_i == pytest.approx(np.tile([-20.0, 0.0], (len(found_i), 1)), abs=1e-6)


def test_by_depth_leaves_out_what_the_other_view_does_not_see():
    points_i, uv_i = wall(2.0)
    points_j, uv_j = wall(1.5)  # something stands in front
    found_i, _ = by_depth(points_i, uv_i, points_j, uv_j, K, np.eye(4))
    assert len(found_i) == 0
    behind = pose(180.0)
    assert len(by_depth(points_i, uv_i, points_i, uv_i, K, behind)[0]) == 0


def test_far_apart_reaches_the_corners():
    grid = np.array([(u, v) for u in range(0, 101, 10) for v in range(0, 101, 10)], float)
    chosen = grid[far_apart(grid, 5, np.random.default_rng(1))]
    corners = {(0.0, 0.0), (0.0, 100.0), (100.0, 0.0), (100.0, 100.0)}
    assert len(corners & {tuple(p) for p in chosen}) >= 3


def test_clicks_have_the_noise_of_a_hand_and_stay_in_the_image():
    rng = np.random.default_rng(2)
    true = np.tile([80.0, 60.0], (1, 1)), np.tile([40.0, 30.0], (1, 1))
    noise = []
    for _ in range(500):
        (click,) = draw_clicks(true, 1, rng, SIZES)
        noise += [*(click.pixel_i - true[0][0]), *(click.pixel_j - true[1][0])]
    assert np.std(noise) == pytest.approx(1.5, rel=0.1)
    assert abs(np.mean(noise)) < 0.15
    corner = np.zeros((1, 2)), np.array([[WIDTH - 1.0, HEIGHT - 1.0]])
    for _ in range(50):
        (click,) = draw_clicks(corner, 1, rng, SIZES)
        assert (click.pixel_i >= 0).all()
        assert (click.pixel_j <= (WIDTH - 1, HEIGHT - 1)).all()


def test_no_more_clicks_than_correspondences():
    rng = np.random.default_rng(3)
    pixels = rng.uniform(10, 100, (2, 2)), rng.uniform(10, 100, (2, 2))
    assert len(draw_clicks(pixels, 3, rng, SIZES)) == 2
    assert draw_clicks((np.zeros((0, 2)), np.zeros((0, 2))), 3, rng, SIZES) == []


def test_moved_points_project_where_by_depth_says():
    points_i, uv_i = wall()
    T_j_i = inverse(pose(5.0, (0.1, 0.05, 0.0)))
    moved = transform(T_j_i, points_i)
    uv_j = (moved @ K.T)[:, :2] / moved[:, 2:]
    found_i, found_j = by_depth(points_i, uv_i, moved, uv_j, K, T_j_i)
    assert len(found_i) == len(points_i)
    assert found_j == pytest.approx(uv_j, abs=1e-9)
