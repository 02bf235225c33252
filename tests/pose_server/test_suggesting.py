"""Points that an operator might confirm."""

import numpy as np

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.diagnostics import with_suggestions
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.suggested_points import SUGGESTED_POINTS, suggested
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from tests.pose_server.scene import K, pair_of_views, turned


def pair_of(T_i_j, seed=3):
    views = pair_of_views(np.random.default_rng(seed), T_i_j)
    return Pair(*(prepare_view(view) for view in views), PAIR.ratio)


def places(pair, T_j_i, row):
    """Where a suggested pixel of i is in j by the truth."""
    at = np.linalg.norm(pair.i.observed.uv - row[:2], axis=1).argmin()
    p = T_j_i[:3, :3] @ pair.i.observed.points[at] + T_j_i[:3, 3]
    return (K @ p)[:2] / p[2]


def test_suggestions_are_true_and_spread_out():
    T_true = turned(20)
    pair = pair_of(T_true)
    rows = suggested(pair, T_true)
    assert 3 <= len(rows) <= SUGGESTED_POINTS.most
    off = [np.linalg.norm(places(pair, inverse(T_true), row) - row[2:]) for row in rows]
    assert np.median(off) < 6.0
    for side in (rows[:, :2], rows[:, 2:]):
        apart = np.linalg.norm(side[:, None] - side[None], axis=2) + 1e9 * np.eye(len(rows))
        assert apart.min() >= 0.1 * pair.i.observed.size[1]


def test_matches_that_agree_with_the_pose_come_first():
    T_true = turned(20)
    pair = pair_of(T_true)
    agrees, other = suggested(pair, T_true), suggested(pair, turned(-40))
    off = [np.linalg.norm(places(pair, inverse(T_true), row) - row[2:]) for row in agrees[:3]]
    assert max(off) < 12.0
    assert other.shape[1] == 4


def test_only_what_is_not_verified_comes_with_suggestions():
    pair = pair_of(turned(20))
    lost = with_suggestions(pair, PairResult(None, None, "rejected", ()))
    assert lost.suggested is not None and len(lost.suggested) <= SUGGESTED_POINTS.most
    sure = align_pair(pair.i, pair.j)
    assert sure.verdict == "verified" and sure.suggested is None
