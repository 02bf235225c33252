"""The method as published beside ours: what it starts from, what it says, what it does not ask."""

import numpy as np
import pytest

from fleetpose.pose_server.registration.paper import align_as_published
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.refinement import Start
from tests.pose_server.scene import pair_of_views, turned
from tests.pose_server.test_starts import POINTS, T_TRUE, clicked


def views(T_i_j: np.ndarray):
    return [prepare_view(one) for one in pair_of_views(np.random.default_rng(0), T_i_j)]


def off_m(T_i_j: np.ndarray, T_true: np.ndarray) -> float:
    return float(np.linalg.norm(T_i_j[:3, 3] - T_true[:3, 3]))


def test_three_clicks_lead_icp_home_and_are_told_as_h_star():
    i, j = views(T_TRUE)
    found = align_as_published(i, j, clicked(POINTS[:3]), ())
    assert found.by_clicks is not None and found.by_clicks.model == "rigid"
    assert np.allclose(found.by_clicks.T_i_j, T_TRUE, atol=1e-3)
    assert off_m(found.T_i_j, T_TRUE) < 0.1 and found.verdict == "verified"
    assert found.icp is not None and found.icp.kept and found.icp.method == "point_to_point"
    assert found.confirmed and found.hearing is not None and all(found.hearing.accepted)


def test_without_clicks_it_starts_from_the_identity_or_from_what_is_known():
    i, j = views(T_TRUE)
    lost = align_as_published(i, j, None, ())
    assert lost.start == "identity" and off_m(lost.T_i_j, T_TRUE) > 1.0
    near = Start("graph", T_TRUE, 0.02)
    found = align_as_published(i, j, None, [near])
    assert found.start == "graph" and off_m(found.T_i_j, T_TRUE) < 0.1


def test_what_is_hidden_in_the_matrix_joins_nothing():
    i, j = views(T_TRUE)
    elsewhere = turned(200)
    found = align_as_published(i, j, None, [Start("graph", elsewhere, 0.02)])
    assert found.verdict == "rejected" and found.p_grave == 1.0
    assert "regression error" in found.reasons[0]


@pytest.mark.parametrize("count", [1, 2])
def test_one_and_two_clicks_shift_without_a_turn(count):
    i, j = views(T_TRUE)
    found = align_as_published(i, j, clicked(POINTS[:count]), ())
    assert found.by_clicks is not None and found.by_clicks.model == "translation"
    assert np.array_equal(found.by_clicks.T_i_j[:3, :3], np.eye(3))
    assert not found.confirmed


def test_too_few_salient_points_are_a_sentence():
    i, j = views(T_TRUE)
    few = i.strongest(2)
    found = align_as_published(few, j, None, ())
    assert found.T_i_j is None and "salient points" in found.reasons[0]
