"""Places that repeat themselves: a pose is believed only if something there is only once."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry.features.patches import sides_seen
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.pose_server.registration.verdict.aliases import aliases_of
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.registration.verdict.explained import explained
from fleetpose.pose_server.registration.verdict.rivals import rivals_of, unique_points
from tests.pose_server.scene import K, descriptors, turned, view

PERIOD_M = 2.0
POSTER_M = 1.4  # from its middle to its edges
STEP = make_pose(np.eye(3), np.array([0.4, 0.05, 0.1]))  # from one camera to the other


def panelled(rng: np.random.Generator, unique: int) -> tuple[PreparedView, PreparedView]:
    """Two views of a wall of equal panels, 10 m away, and a poster with so many points."""
    panel = np.column_stack(
        (rng.uniform(0, PERIOD_M, 60), rng.uniform(-3, 3, 60), rng.uniform(9.8, 10.2, 60))
    )
    places = np.arange(-4, 4) * PERIOD_M
    points = np.concatenate([panel + np.array((x, 0.0, 0.0)) for x in places])
    looks = np.tile(descriptors(rng, 60), (len(places), 1))
    if unique:  # a poster hides what it hangs on
        bare = (np.abs(points[:, :2]) > POSTER_M).any(axis=1)
        poster = np.column_stack(
            (rng.uniform(-POSTER_M, POSTER_M, (unique, 2)), np.full(unique, 9.7))
        )
        points = np.concatenate((points[bare], poster))
        looks = np.concatenate((looks[bare], descriptors(rng, unique)))
    return (
        prepare_view(view(rng, "r1", points, looks, np.eye(4))),
        prepare_view(view(rng, "r2", points, looks, inverse(STEP))),
    )


def aligned(unique: int) -> PairResult:
    return align_pair(*panelled(np.random.default_rng(5), unique))


def test_a_wall_of_equal_panels_is_never_verified():
    found = aligned(0)
    assert found.verdict != "verified"
    assert found.p_grave > 0.2


@pytest.mark.parametrize("unique", [120])
def test_what_is_there_only_once_breaks_the_tie(unique):
    found = aligned(unique)
    assert found.T_i_j is not None
    assert np.linalg.norm(found.T_i_j[:3, 3] - STEP[:3, 3]) < 0.2
    assert found.verdict == "verified"


def test_a_view_of_equal_panels_is_mapped_onto_itself_by_their_period():
    i, _ = panelled(np.random.default_rng(5), 0)
    found = aliases_of(i)
    assert found
    for alias in found:
        steps = alias.T[:3, 3] / PERIOD_M
        assert np.allclose(steps, (np.rint(steps[0]), 0.0, 0.0), atol=0.1) and abs(steps[0]) > 0.9
        assert alias.repeated.mean() > 0.4


def test_a_place_without_repetitions_has_no_aliases():
    rng = np.random.default_rng(8)
    points = np.column_stack((rng.uniform(-8, 8, 400), rng.uniform(-3, 3, 400), np.full(400, 10.0)))
    assert not aliases_of(prepare_view(view(rng, "r1", points, descriptors(rng, 400), np.eye(4))))


def test_what_stands_there_only_once_is_not_explained_by_the_period():
    i, _ = panelled(np.random.default_rng(5), 120)
    poster = np.flatnonzero((np.abs(i.observed.points[:, :2]) < POSTER_M).all(axis=1))
    panels = np.flatnonzero((np.abs(i.observed.points[:, :2]) > 2 * POSTER_M).any(axis=1))
    (alias, *_) = aliases_of(i)
    assert alias.unexplained(i, poster)[0] > 0.7 * len(poster)
    assert alias.unexplained(i, panels)[0] < 0.1 * len(panels) and not alias.explains(poster)


def test_where_a_view_repeats_one_step_further_is_a_rival_whatever_is_found_there():
    i, j = panelled(np.random.default_rng(5), 0)
    pair = Pair(i, j, PAIR.ratio)
    exact = pair.exact(STEP, pair.guided(STEP, 0.008))
    steps = [rival.T_i_j[:3, 3] - STEP[:3, 3] for rival in rivals_of(pair, STEP, exact)]
    assert any(abs(abs(step[0]) - PERIOD_M) < 0.2 for step in steps)
    assert unique_points(pair, exact) == 0


def test_a_right_pose_explains_more_than_one_a_panel_further():
    i, j = panelled(np.random.default_rng(6), 40)
    pair = Pair(i, j, PAIR.ratio)
    beside = make_pose(np.eye(3), STEP[:3, 3] + (PERIOD_M, 0.0, 0.0))
    holes = []
    for T in (STEP, beside):
        matches = np.unique(np.concatenate((pair.guided(T, 0.008), pair.ratio)), axis=0)
        holes.append(
            explained(pair, T, pair.exact(T, matches), np.zeros(len(pair.ratio), bool)).holes
        )
    assert holes[0] < 0.05 < holes[1]


def test_a_camera_behind_a_wall_would_see_it_from_behind():
    i, _ = panelled(np.random.default_rng(7), 0)
    patches = i.surface.patches
    behind = make_pose(exp_so3(np.array([0.0, np.pi, 0.0])), np.array([0.0, 0.0, 20.0]))
    assert sides_seen(patches, inverse(turned(20)), K, i.surface.size).front > 0.95
    seen = sides_seen(patches, inverse(behind), K, i.surface.size)
    assert seen.told > 20 and seen.front < 0.05
