"""What the fleet solve says about its own errors."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.pose_graph import factors
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.links import link
from fleetpose.pose_server.pose_graph.types import SolveSettings
from tests.pose_server.fleet_makers import click, edge, exp_se3, left_error, ring, view

NODES = [view(f"r{k}") for k in range(6)]
TRUTH = ring(6)
NO_FLOOR = SolveSettings(floor_rotation_rad=0.0, floor_translation_m=0.0, shared_share=0.0)


def nees(error, covariance):
    return float(error @ np.linalg.solve(covariance, error)) / len(error)


def test_right_covariance_of_a_link_is_that_of_right_perturbations():
    rng = np.random.default_rng(0)
    T_true = exp_se3(np.array([0.3, -0.5, 0.4, 1.0, -2.0, 0.5]))
    A = rng.normal(size=(6, 6)) * np.array([0.01] * 3 + [0.03] * 3)[:, None]
    covariance = A @ A.T
    left = rng.multivariate_normal(np.zeros(6), covariance, size=4000)
    right = [left_error(inverse(T_true) @ exp_se3(xi) @ T_true, np.eye(4)) for xi in left]
    stated = link(0, 1, T_true, covariance, 2).right
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    assert np.abs((np.cov(np.array(right).T) - stated) / scale).max() < 0.08


def test_covariance_is_calibrated_in_monte_carlo():
    values: dict[str, list[float]] = {"root": [], "relative": []}
    rng = np.random.default_rng(1)
    sigmas = np.array([0.004, 0.01, 0.006, 0.03, 0.01, 0.02])
    for _ in range(100):
        edges = [edge(NODES, TRUTH, k, (k + 1) % 6, rng, sigmas) for k in range(6)]
        edges += [edge(NODES, TRUTH, 4, 1, rng, 2 * sigmas)]
        solution = solve_fleet(
            NODES, edges, gauge=NODES[0], newest={n.robot: n for n in NODES}, settings=NO_FLOOR
        )
        for k in range(1, 6):
            pose = solution.nodes[NODES[k]]
            error = left_error(pose.T_root_camera, inverse(TRUTH[0]) @ TRUTH[k])
            values["root"].append(nees(error, pose.covariance))
        relative = solution.relative(NODES[2], NODES[5])
        assert relative is not None
        error = left_error(relative.T_a_b, inverse(TRUTH[2]) @ TRUTH[5])
        values["relative"].append(nees(error, relative.covariance))
    for name, numbers in values.items():
        assert 0.7 < np.mean(numbers) < 1.4, name
        assert 0.8 < np.mean(numbers) < 1.2, name


def test_covariance_is_calibrated_where_clicks_take_part():
    rng = np.random.default_rng(2)
    loose = np.array([0.05] * 3 + [0.3] * 3)
    numbers = []
    for _ in range(60):
        edges = [edge(NODES, TRUTH, 0, 1, rng, loose)]
        points = rng.normal(size=(4, 3)) * 0.6
        clicks = [click(NODES, TRUTH, 0, 1, p, rng, n) for n, p in enumerate(points)]
        solution = solve_fleet(
            NODES, edges, clicks, gauge=NODES[0], wanted=[NODES[1]], settings=NO_FLOOR
        )
        pose = solution.nodes[NODES[1]]
        error = left_error(pose.T_root_camera, inverse(TRUTH[0]) @ TRUTH[1])
        numbers.append(nees(error, pose.covariance))
    assert 0.6 < np.mean(numbers) < 1.5


def test_floor_bounds_how_sure_many_edges_of_one_pair_can_be():
    precise = np.full(6, 1e-6)
    settings = SolveSettings(floor_rotation_rad=0.001, floor_translation_m=0.02)
    solution = solve_fleet(
        NODES,
        [edge(NODES, TRUTH, 0, 1, None, precise)],
        gauge=NODES[0],
        wanted=[NODES[1]],
        settings=settings,
    )
    T = solution.nodes[NODES[1]].T_root_camera
    covariance = solution.nodes[NODES[1]].covariance
    at_camera = link(0, 1, T, covariance, 2).right
    assert np.allclose(np.sqrt(np.diag(at_camera)), [0.001] * 3 + [0.02] * 3, rtol=0.02)


def test_covariance_is_only_made_for_the_nodes_asked_for():
    edges = [edge(NODES, TRUTH, 0, 1, None), edge(NODES, TRUTH, 1, 2, None)]
    solution = solve_fleet(NODES, edges, gauge=NODES[0], wanted=[NODES[2]])
    assert solution.nodes[NODES[2]].covariance is not None
    assert solution.nodes[NODES[1]].covariance is None
    assert solution.nodes[NODES[1]].why_no_covariance == "not asked for"


def test_undetermined_graph_gives_a_reason_instead_of_a_covariance():
    graph = factors.graph_of([factors.between(link(0, 1, np.eye(4), np.eye(6), 2))])
    values = factors.values_of([np.eye(4), np.eye(4)])
    reason = factors.marginals_or_reason(graph, values)
    assert isinstance(reason, str) and "do not determine" in reason


@pytest.mark.parametrize("far", [1, 3])
def test_uncertainty_grows_along_a_chain(far):
    edges = [edge(NODES, TRUTH, k, k + 1, None) for k in range(4)]
    solution = solve_fleet(NODES, edges, gauge=NODES[0], wanted=NODES)
    near, further = (solution.nodes[NODES[k]].covariance for k in (far, far + 1))
    assert np.linalg.eigvalsh(further - near).min() > -1e-9


def test_edges_of_one_view_add_less_the_more_there_are():
    def ratio(reach: int) -> float:
        pairs = [(a, (a + k) % 6) for a in range(6) for k in range(1, reach + 1)]
        edges = [edge(NODES, TRUTH, a, b, None) for a, b in pairs]
        sizes = [
            np.trace(
                solve_fleet(
                    NODES,
                    edges,
                    gauge=NODES[0],
                    wanted=[NODES[3]],
                    settings=SolveSettings(shared_share=shared),
                )
                .nodes[NODES[3]]
                .covariance
            )
            for shared in (0.3, 0.0)  # half of it: what edges rest on is not known
        ]
        return float(sizes[0] / sizes[1])

    assert 1.1 < ratio(1) < 1.2  # of two edges each
    assert 1.4 < ratio(2) < 1.5  # of four


def test_a_fleet_that_closes_better_than_its_edges_say_is_surer_and_never_by_too_much():
    """Edges that state too large covariances are found out by their cycles; few cycles prove
    nothing, and edges that are right are believed as they are.
    """
    rng = np.random.default_rng(5)
    pairs = [(a, b) for a in range(6) for b in range(a + 1, 6)]

    def sigma_m(stated: float, used: list[tuple[int, int]]) -> float:
        edges = [edge(NODES, TRUTH, a, b, rng) for a, b in used]
        edges = [replace(e, covariance=stated * e.covariance) for e in edges]
        solution = solve_fleet(NODES, edges, gauge=NODES[0], wanted=NODES, settings=NO_FLOOR)
        covariance = solution.nodes[NODES[3]].covariance
        return float(np.sqrt(np.trace(covariance[3:, 3:])))

    right = np.mean([sigma_m(1.0, pairs) for _ in range(20)])
    wide = np.mean([sigma_m(8.0, pairs) for _ in range(20)])
    assert wide < 0.8 * np.sqrt(8.0) * right
    assert wide > 0.45 * np.sqrt(8.0) * right
    tree = [(0, k) for k in range(1, 6)]
    assert sigma_m(8.0, tree) == pytest.approx(np.sqrt(8.0) * sigma_m(1.0, tree), rel=0.2)
