"""`pose-eval solve`: made-up fleets and recorded pose graphs."""

import numpy as np
import pytest

from fleetpose.evaluation.bench.solve import make_up, mean_error_m, read_g2o, run, run_recorded
from fleetpose.evaluation.options.recorded import SolveOptions
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from tests.data import shared_data

TWO_ROBOTS = """VERTEX_SE3:QUAT 6989586621679009792 0 0 0 0 0 0 1
VERTEX_SE3:QUAT 7061644215716937728 1 2 3 0 0 0 1
EDGE_SE3:QUAT 6989586621679009792 7061644215716937728 1 2 3 0 0 0 1 \
100 0 0 0 0 0 100 0 0 0 0 25 0 0 0 10000 0 0 10000 0 10000
"""


def test_wrong_edges_are_found_and_cost_nothing(tmp_path):
    summary = run(SolveOptions(30, 160, 0.3), tmp_path)
    assert summary["located"] >= 28  # one of which one edge says this and one that is not
    assert summary["wrong"] == 48
    assert summary["wrong_found"] >= 46
    assert summary["error_vs_clean"] <= 1.1


def test_a_made_up_fleet_without_wrong_edges_is_solved_to_its_noise():
    fleet = make_up(12, 40, 0.0, np.random.default_rng(0))
    solution = solve_fleet(fleet.nodes, fleet.edges, gauge=fleet.nodes[0])
    assert not any(one.outlier for one in solution.edges.values())
    assert mean_error_m(fleet, solution) < 0.3


@pytest.mark.parametrize("edges", [5, 10_000])
def test_impossible_numbers_of_edges_are_refused(edges, tmp_path):
    with pytest.raises(FleetPoseError, match="--edges"):
        run(SolveOptions(10, edges, 0.0), tmp_path)


def test_a_g2o_edge_keeps_its_pose_and_its_sigmas(tmp_path):
    (tmp_path / "two.g2o").write_text(TWO_ROBOTS)
    (edge,) = read_g2o(tmp_path)
    assert (edge.a.robot, edge.b.robot, edge.kind) == ("a", "b", "pair")
    assert np.allclose(edge.T_a_b[:3, 3], [1, 2, 3])
    solution = solve_fleet([edge.a, edge.b], [edge], gauge=edge.a, newest={"b": edge.b})
    covariance = solution.nodes[edge.b].covariance
    assert covariance is not None
    assert np.allclose(np.diag(edge.covariance)[:3], 1e-4)  # left: rotations as they are


def test_what_is_no_pose_graph_is_refused_with_a_sentence(tmp_path):
    with pytest.raises(DataFolderError, match="holds no pose graph"):
        list(read_g2o(tmp_path))
    with pytest.raises(DataFolderError):
        list(read_g2o(tmp_path / "absent.g2o"))


def test_a_recorded_graph_of_two_robots_becomes_one(tmp_path):
    summary = run_recorded(shared_data("posegraph_kitti00") / "2robots", tmp_path)
    assert summary["joined"] == summary["nodes"] == 2294
    assert summary["between_robots"] == 232
    assert (tmp_path / "map.png").stat().st_size > 1000
