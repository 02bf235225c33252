"""Clicks that deceive: they are wrong as they should be, and the server's own site is asked."""

import json
from itertools import pairwise

import numpy as np
import pytest

from fleetpose.evaluation.bench.clicks.command import ClicksOptions
from fleetpose.evaluation.bench.clicks.deceived import Deceived, run, summarize
from fleetpose.evaluation.bench.clicks.deceptive import (
    corners_in_order,
    in_other_orders,
    one_step_along,
)
from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.metrics.geometry import inverse, transform
from tests.evaluation.makers import write_rgbd


class Point:
    """What a lifter would give."""

    def __init__(self, p):
        self.p = p


@pytest.fixture
def recording(tmp_path):
    write_rgbd(tmp_path / "data", 2)
    return open_recording(tmp_path / "data")


def lift_from(recording):
    """Lifts by the recorded depths."""
    from fleetpose.evaluation.data.opening import points_of

    clouds = [points_of(view) for view in recording.views[:2]]

    def lift(side, pixel):
        uv, points = clouds[side]
        nearest = np.linalg.norm(uv - pixel, axis=1).argmin()
        return Point(points[nearest])

    return lift


def test_clicks_one_step_along_the_surface_all_show_a_place_as_far_off(recording):
    i, j = recording.views[:2]
    lift, rng = lift_from(recording), np.random.default_rng(1)
    clicked = one_step_along(recording, (i, j), 0.2, 4, rng, lift)
    assert clicked is not None and clicked.wrong.all() and len(clicked) == 4
    T_i_j = inverse(i.T_world_camera) @ j.T_world_camera
    steps = []
    for uv_i, uv_j in zip(*clicked.pixels, strict=True):
        p_i, p_j = lift(0, uv_i).p, lift(1, uv_j).p
        steps.append(transform(T_i_j, p_j[None])[0] - p_i)
    assert np.allclose(np.linalg.norm(steps, axis=1), 0.2, atol=0.06)
    assert all(a @ b > 0 for a, b in pairwise(steps))  # all to one side


def test_every_wrong_order_of_four_points_of_a_plane_is_clicked_once(recording):
    pair, rng = recording.views[:2], np.random.default_rng(2)
    true = true_pixels(recording, *pair)
    right = corners_in_order(recording, (pair[0], pair[1]), true, rng, lift_from(recording))
    assert right is not None and not right.wrong.any() and len(right) == 4
    others = in_other_orders(right)
    assert len(others) == 23
    assert len({other.pixels[1].tobytes() for other in others}) == 23
    assert all(other.wrong.sum() in (2, 3, 4) for other in others)


def test_summary_counts_what_must_not_be_and_shares_what_must():
    good = Deceived(0, 1, 40.0, 0, 3, 3, False, False, True, "", True, True, True, False, None, 0.1)
    bad = Deceived(0, 1, 40.0, 1, 3, 3, True, True, False, "", False, False, True, True, 3.0, 3.0)
    summary = summarize([good, good, good, bad])
    assert summary["grave_located"] == 1 and summary["told_wrong"] == summary["recovered"] == 0.75


@pytest.mark.parametrize("how", [{"consistent_wrong_m": 0.2, "clicks": (3, 4)}, {"permuted": True}])
def test_the_command_asks_the_servers_own_site(tmp_path, how):
    write_rgbd(tmp_path / "data", 2)
    options = ClicksOptions(
        tmp_path / "data", angles_deg=(0.0, 90.0), min_shared=0, draws=1, workers=1, **how
    )
    summary = run(options, tmp_path / "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == pytest.approx(summary)
    assert summary["draws"] == (23 if "permuted" in how else 1)
    assert summary["grave_located"] == summary["grave_located_after"] == 0
    assert summary["told_wrong"] == 1.0
    assert (tmp_path / "out" / "deceived.csv").exists()
