"""Mistakes of people are what they say: the next window, one step along, left for right, one of
several; and right picks are anything with contrast that both views see.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.bench.clicks.truth import true_depth, true_pixels, with_contrast
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.geometry import inverse, transform
from fleetpose.evaluation.simulate.mistakes import MISTAKES, Sight, mistaken, repeats_by
from fleetpose.evaluation.simulate.operator import by_depth_images, by_hand
from tests.evaluation.makers import HEIGHT, WIDTH, K, pose, write_posed_views

SIZE = (WIDTH, HEIGHT)
PERIOD_M, Z_M = 0.4, 3.0
RNG = np.random.default_rng


def lifted(uv, z=Z_M):
    return np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(K).T * z


def facade(repeats=True) -> Sight:
    """A wall 3 m away that is the same every 0.4 m, or nowhere; every pixel has a depth."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    uv = np.column_stack((u.ravel(), v.ravel())).astype(float)
    rng = RNG(3)
    cell = np.column_stack((rng.uniform(0, PERIOD_M, 8), rng.uniform(-0.8, 0.8, 8)))
    looks = rng.uniform(0, 255, (8, 128))
    places = np.concatenate([cell + np.array((k * PERIOD_M, 0.0)) for k in range(-4, 4)])
    marks = np.column_stack((places, np.full(len(places), Z_M)))
    marks_uv = (marks @ K.T)[:, :2] / Z_M
    inside = ((marks_uv >= 0) & (marks_uv <= np.subtract(SIZE, 1))).all(axis=1)
    look = np.tile(looks, (8, 1)) if repeats else rng.uniform(0, 255, (64, 128))
    return Sight(K, SIZE, uv, lifted(uv), marks_uv[inside], marks[inside], look[inside])


def picks(view: Sight, count=20):
    """True answers of two views at the same place, at what catches the eye."""
    order = RNG(0).permutation(len(view.marks_uv))[:count]
    return view.marks_uv[order].copy(), view.marks_uv[order].copy()


def test_the_step_by_which_a_place_repeats_itself_is_found_and_only_there():
    assert repeats_by(facade()) == pytest.approx((PERIOD_M, 0.0, 0.0), abs=1e-9)
    assert repeats_by(facade(repeats=False)) is None


def test_one_step_moves_all_points_by_the_period_so_that_they_fit_each_other():
    view = facade()
    for seed in range(5):
        answer = MISTAKES["step"](picks(view), view, 4, RNG(seed))
        assert answer is not None
        moved = lifted(answer.pixels[1]) - lifted(answer.pixels[0])
        assert np.abs(moved[:, 0]) == pytest.approx(PERIOD_M, abs=1e-6)
        assert np.ptp(moved, axis=0) == pytest.approx(0.0, abs=1e-6)
        assert answer.wrong.all()


def test_where_nothing_repeats_a_step_goes_along_the_wall():
    view = facade(repeats=False)
    answer = MISTAKES["step"](picks(view), view, 3, RNG(1))
    assert answer is not None
    moved = lifted(answer.pixels[1]) - lifted(answer.pixels[0])
    assert np.ptp(moved, axis=0) == pytest.approx(0.0, abs=1e-6)
    assert 0.1 * Z_M - 1e-6 <= abs(moved[0, 0]) <= 0.25 * Z_M + 1e-6
    assert moved[0, 1] == pytest.approx(0.0, abs=1e-9)


def test_a_step_never_ends_where_the_second_view_sees_another_surface():
    view = facade()
    cut = view.uv[:, 0] > WIDTH / 2
    nearer = replace(view, xyz=np.where(cut[:, None], 0.6 * view.xyz, view.xyz))
    true = picks(view)
    left = true[0][:, 0] < WIDTH / 2 - 5
    answer = MISTAKES["step"]((true[0][left], true[1][left]), nearer, 2, RNG(0))
    assert answer is None or (answer.pixels[1][:, 0] <= WIDTH / 2).all()


def test_the_next_window_looks_the_same_and_is_another():
    view = facade()
    answer = MISTAKES["alike"](picks(view), view, 3, RNG(0))
    assert answer is not None
    moved = (lifted(answer.pixels[1]) - lifted(answer.pixels[0]))[:, 0]
    periods = moved / PERIOD_M
    assert periods == pytest.approx(np.rint(periods), abs=1e-6)
    assert (np.abs(np.rint(periods)) >= 1).all()
    unlike = facade(repeats=False)
    assert MISTAKES["alike"](picks(unlike), unlike, 3, RNG(0)) is None


def test_one_wrong_point_among_right_ones_is_the_one_that_is_named():
    view = facade()
    for seed in range(6):
        answer = MISTAKES["one"](picks(view), view, 4, RNG(seed))
        assert answer is not None
        off = np.linalg.norm(answer.pixels[1] - answer.pixels[0], axis=1) > 1.0
        assert off.tolist() == answer.wrong.tolist()
        assert off.sum() == 1
        assert len(np.unique(answer.pixels[0], axis=0)) == 4


def test_left_and_right_are_exchanged_about_the_middle():
    view = facade(repeats=False)
    answer = MISTAKES["mirrored"](picks(view), view, 3, RNG(0))
    assert answer is not None
    right, wrong = lifted(answer.pixels[0]), lifted(answer.pixels[1])
    middle = right.mean(axis=0)
    assert wrong[:, 0] - middle[0] == pytest.approx(middle[0] - right[:, 0], abs=1e-6)
    assert wrong[:, 1:] == pytest.approx(right[:, 1:], abs=1e-6)
    assert answer.wrong.sum() >= 2


def test_every_kind_is_made_where_it_can_be_and_none_where_nothing_is_known():
    view = facade()
    made = {mistaken(picks(view), view, 3, RNG(seed)).kind for seed in range(40)}
    assert made == set(MISTAKES)
    nothing = np.zeros((0, 2)), np.zeros((0, 2))
    assert mistaken(nothing, view, 3, RNG(0)) is None
    blind = replace(view, uv=view.uv[:0], xyz=view.xyz[:0], marks_uv=view.marks_uv[:0],
                    marks_xyz=view.marks_xyz[:0], looks=view.looks[:0])  # fmt: skip
    assert mistaken(picks(view), blind, 3, RNG(0)) is None


def test_a_hand_adds_its_noise_and_stays_in_the_image():
    pixels = np.tile((0.0, HEIGHT - 1.0), (400, 1))
    aside = np.array((50.0, -50.0))
    clicks = by_hand((pixels, pixels + aside), RNG(0), (SIZE, SIZE))
    first = np.array([click.pixel_i for click in clicks])
    second = np.array([click.pixel_j for click in clicks]) - pixels - aside
    assert (first >= 0).all()
    assert (first <= np.subtract(SIZE, 1)).all()
    assert second.std() == pytest.approx(1.5, abs=0.15)


def test_pixels_with_depth_are_found_again_where_the_other_view_sees_them():
    depth_i = np.full((HEIGHT, WIDTH), 2.0)
    depth_i[:, :40] = np.nan
    T_j_i = inverse(pose(0.0, (0.2, 0.0, 0.0)))
    uv = np.array([(20.0, 60.0), (100.0, 60.0), (25.0, 30.0), (60.0, 30.0)])
    found_i, found_j = by_depth_images(uv, depth_i, np.full((HEIGHT, WIDTH), 2.0), K, K, T_j_i)
    assert found_i.tolist() == [[100.0, 60.0], [60.0, 30.0]]  # the others have no depth
    assert found_j == pytest.approx(found_i - (20.0, 0.0))
    hidden, _ = by_depth_images(uv, depth_i, np.full((HEIGHT, WIDTH), 1.5), K, K, T_j_i)
    assert len(hidden) == 0
    outside, _ = by_depth_images(uv, depth_i, depth_i, K, K, inverse(pose(0.0, (3.0, 0.0, 0.0))))
    assert len(outside) == 0


def test_picks_need_contrast(tmp_path):
    image = np.full((HEIGHT, WIDTH), 120, np.uint8)
    image[40:80, 30:60] = 200
    cv2.imwrite(str(tmp_path / "square.png"), image)
    found = with_contrast(tmp_path / "square.png", SIZE)
    corners = np.array([(30, 40), (59, 40), (30, 79), (59, 79)])
    assert all(np.linalg.norm(found - corner, axis=1).min() < 3 for corner in corners)
    assert all(np.linalg.norm(corners - place, axis=1).min() < 12 for place in found)
    cv2.imwrite(str(tmp_path / "plain.png"), np.full((HEIGHT, WIDTH), 120, np.uint8))
    assert len(with_contrast(tmp_path / "plain.png", SIZE)) == 0


def test_where_all_depths_are_known_picks_are_no_tracks(tmp_path):
    write_posed_views(tmp_path)
    recording = open_recording(tmp_path, "sparse_noisy")
    i, j = recording.usable[:2]
    assert true_depth(recording, i) is None
    assert len(true_pixels(recording, i, j)[0]) == 280  # only tracks are known
    (tmp_path / "depth").mkdir()
    for view in recording.usable:
        millimetres = np.full((HEIGHT, WIDTH), 2000, np.uint16)
        cv2.imwrite(str(tmp_path / "depth" / view.name), millimetres)
    uv_i, uv_j = true_pixels(recording, i, j)
    assert len(uv_i) > 50
    _, tracks = recording.tracks(i)
    gaps = np.linalg.norm(uv_i[:, None] - tracks[None], axis=2).min(axis=1)
    assert np.median(gaps) > 1.0
    moved = transform(inverse(j.T_world_camera) @ i.T_world_camera, lifted(uv_i, 2.0))
    assert uv_j == pytest.approx((moved @ K.T)[:, :2] / moved[:, 2:])
