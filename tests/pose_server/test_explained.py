"""What is missing although it should be seen."""

import numpy as np
import pytest

from fleetpose.pose_server.registration.verdict.explained import Visible, holes

SIZE = (640.0, 480.0)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("share", [0.3, 0.5, 0.8])
def test_points_found_everywhere_leave_no_hole_and_a_poster_that_is_missing_does(seed, share):
    rng = np.random.default_rng(seed)
    uv = rng.random((1500, 2)) * SIZE
    visible = Visible(np.ones(len(uv), bool), np.full(len(uv), 0.2), np.zeros(len(uv)), uv)
    found = rng.random(len(uv)) < share
    poster = np.linalg.norm(uv - (300.0, 200.0), axis=1) < 120.0
    assert holes(uv, visible, np.flatnonzero(found)) < 0.03
    assert holes(uv, visible, np.flatnonzero(found & ~poster)) > 0.3 * poster.mean()


def test_a_wide_angle_excuses_what_is_missing_there():
    rng = np.random.default_rng(0)
    uv = rng.random((1500, 2)) * SIZE
    oblique = uv[:, 0] < 160.0
    angle = np.where(oblique, 1.5, 0.2)
    found = np.flatnonzero((rng.random(len(uv)) < 0.5) & ~oblique)
    everywhere = np.ones(len(uv), bool)
    seen_well = Visible(everywhere, np.full(len(uv), 0.2), np.zeros(len(uv)), uv)
    at_an_angle = Visible(everywhere, angle, np.zeros(len(uv)), uv)
    assert holes(uv, at_an_angle, found) < 0.7 * holes(uv, seen_well, found)


def test_where_hardly_anything_is_seen_nothing_can_be_missing():
    uv = np.array([[10.0, 10.0], [20.0, 20.0]])
    visible = Visible(np.ones(2, bool), np.zeros(2), np.zeros(2), uv)
    assert holes(uv, visible, np.zeros(0, np.int64)) == 0.0
    assert (
        holes(uv[:0], Visible(*(np.zeros(0, t) for t in (bool, float, float)), uv[:0]), []) == 0.0
    )


def test_what_is_tilted_much_from_one_image_to_the_other_is_not_missed():
    rng = np.random.default_rng(1)
    uv = rng.random((1500, 2)) * SIZE
    tilted = uv[:, 0] < 160.0
    there = np.where(tilted[:, None], uv * (0.15, 1.0), uv)
    found = np.flatnonzero((rng.random(len(uv)) < 0.5) & ~tilted)
    alike, squeezed = (
        Visible(np.ones(len(uv), bool), np.full(len(uv), 0.2), np.zeros(len(uv)), at)
        for at in (uv, there)
    )
    assert holes(uv, squeezed, found) < 0.4 * holes(uv, alike, found)
