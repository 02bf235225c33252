"""Edges of one view share the errors of the points that they have in common."""

import numpy as np
import pytest

from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.shared_errors import overlaps
from tests.pose_server.fleet_makers import edge, exp_se3, ring, thing, view

NODES = [view(f"r{k}") for k in range(5)]
TRUTH = ring(5)


def structures(rng, count):
    roots = rng.normal(size=(count, 3, 3))
    return rng.normal(size=(count, 3)), roots @ roots.transpose(0, 2, 1) + 0.01 * np.eye(3)


def all_overlaps(centres, spreads):
    """(N, N) of all with all."""
    first, second = (grid.ravel() for grid in np.indices((len(centres), len(centres))))
    return overlaps(centres, spreads, first, second).reshape(len(centres), -1)


def test_overlap_is_one_with_itself_symmetric_and_between_none_and_all():
    centres, spreads = structures(np.random.default_rng(0), 12)
    found = all_overlaps(centres, spreads)
    np.testing.assert_allclose(found.diagonal(), 1.0)
    np.testing.assert_allclose(found, found.T, atol=1e-12)
    assert (found > 0).all() and (found <= 1 + 1e-12).all()


def test_overlap_does_not_depend_on_the_frame_nor_the_unit():
    centres, spreads = structures(np.random.default_rng(1), 6)
    T = exp_se3(np.random.default_rng(2).normal(size=6))
    R = T[:3, :3]
    moved = all_overlaps(5 * (centres @ R.T + T[:3, 3]), 25 * R @ spreads @ R.T)
    np.testing.assert_allclose(moved, all_overlaps(centres, spreads), atol=1e-9)


@pytest.mark.parametrize(("apart_m", "low", "high"), [(0.0, 0.99, 1.0), (50.0, 0.0, 0.01)])
def test_overlap_falls_with_distance(apart_m, low, high):
    centres = np.array([[0.0, 0.0, 0.0], [apart_m, 0.0, 0.0]])
    found = all_overlaps(centres, np.stack([np.eye(3)] * 2))[0, 1]
    assert low <= found <= high


def test_what_is_not_known_is_between_both():
    centres = np.array([[0.0, 0.0, 0.0], [np.nan, np.nan, np.nan]])
    found = all_overlaps(centres, np.stack([np.eye(3)] * 2))
    assert 0.1 < found[0, 1] < 0.9


def test_many_edges_on_the_same_points_say_less_than_on_different_ones():
    def size(places) -> float:
        edges = [
            edge(NODES, TRUTH, 0, k + 1, None, rests_on=place) for k, place in enumerate(places)
        ]
        edges += [edge(NODES, TRUTH, k + 1, (k + 1) % 4 + 1, None) for k in range(4)]
        solution = solve_fleet(NODES, edges, gauge=NODES[0], wanted=[NODES[1]])
        covariance = solution.nodes[NODES[1]].covariance
        assert covariance is not None
        return float(np.trace(covariance))

    same = size([thing(0.0)] * 4)
    different = size([thing(x) for x in (-30.0, -10.0, 10.0, 30.0)])
    assert same > 1.1 * different
