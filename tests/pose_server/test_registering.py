"""ICP of every pair: what it did is told, and what it spoils is not kept."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry import icp
from fleetpose.pose_server.geometry.se3 import retract
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.pair_icp import registered
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.refinement import Candidate, with_icp
from tests.pose_server.scene import pair_of_views, turned

T_TRUE = turned(20)
METHODS = ["gicp", "point_to_point", "point_to_plane"]


@pytest.fixture(scope="module")
def views():
    return [prepare_view(one) for one in pair_of_views(np.random.default_rng(3), T_TRUE)]


def skip_without_open3d(method: str) -> None:
    if method != "gicp" and not icp.has_open3d():
        pytest.skip("Open3D needs libraries of the system that are not here")


@pytest.mark.parametrize("method", METHODS)
def test_an_icp_of_noisy_sparse_points_that_spoils_the_pose_is_told_and_not_kept(views, method):
    skip_without_open3d(method)
    found = align_pair(*views, icp=method)
    assert found.verdict == "verified" and found.icp is not None
    assert np.linalg.norm(found.T_i_j[:3, 3] - T_TRUE[:3, 3]) < 0.1
    after = registered(Pair(*views, PAIR.ratio), found.T_i_j, method)
    off_m = np.linalg.norm(after.T_i_j[:3, 3] - T_TRUE[:3, 3])
    assert found.icp.kept == (off_m < np.linalg.norm(found.T_i_j[:3, 3] - T_TRUE[:3, 3]))
    assert found.icp.ms > 0 and found.icp.count > 50
    assert found.icp.rms_m == pytest.approx(np.sqrt(found.icp.error_m2 / found.icp.count))


def test_off_is_off(views):
    assert align_pair(*views, icp="off").icp is None


@pytest.mark.parametrize("method", METHODS)
def test_a_pose_that_it_mends_is_kept(views, method):
    skip_without_open3d(method)
    pair = Pair(*views, PAIR.ratio)
    off = retract(T_TRUE, np.array([0.0, 0.0, 0.0, 0.12, 0.0, 0.0]))
    mended = with_icp(pair, Candidate(pair, "graph", off), method)
    assert mended.icp is not None and mended.icp.kept
    near = np.linalg.norm(mended.T_i_j[:3, 3] - T_TRUE[:3, 3])
    assert near < 0.8 * np.linalg.norm(off[:3, 3] - T_TRUE[:3, 3])


def test_a_library_that_is_missing_says_what_to_install(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(icp.MissingLibraryError, match="fleetpose"):
        icp.open3d()
    assert not icp.has_open3d()
