"""Clicks as factors of the fleet solve."""

from dataclasses import replace

import numpy as np

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from tests.pose_server.fleet_makers import click, edge, exp_se3, position_errors, ring, view

NODES = [view("a"), view("b")]
TRUTH = ring(8)[:2]
LOOSE = np.array([0.05] * 3 + [0.4] * 3)
POINTS = np.array([[0.5, 0.2, 0.3], [-0.6, 0.5, 0.1], [0.1, -0.7, -0.4], [0.3, 0.4, -0.6]])


def clicks_on(points, rng=None, first=0, **options):
    return [
        click(NODES, TRUTH, 0, 1, point, rng, first + k, **options)
        for k, point in enumerate(points)
    ]


def test_clicks_pull_a_badly_known_edge():
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(20):
        loose = edge(NODES, TRUTH, 0, 1, rng, LOOSE)
        errors.append(
            [
                position_errors(solve_fleet(NODES, [loose], clicks), NODES, TRUTH, 0)[1]
                for clicks in ([], clicks_on(POINTS, rng))
            ]
        )
    without, with_clicks = np.median(errors, axis=0)
    assert with_clicks < 0.4 * without


def test_clicks_that_were_moved_are_asked_again():
    tight = edge(NODES, TRUTH, 0, 1, None)
    before = solve_fleet(NODES, [tight], clicks_on(POINTS))
    moved = [
        replace(click, p_a=click.p_a + np.array([0.0, 0.02, 0.0])) for click in clicks_on(POINTS)
    ]
    same, anew = (
        solve_fleet(NODES, [tight], moved, previous=previous) for previous in (before, None)
    )
    T = [one.nodes[NODES[1]].T_root_camera for one in (before, same, anew)]
    assert np.allclose(T[1], T[2], atol=1e-4)
    assert not np.allclose(T[0], T[2], atol=1e-3)


def test_one_click_helps_without_determining_a_pose():
    rng = np.random.default_rng(1)
    sizes = []
    for clicks in ([], clicks_on(POINTS[:1], rng)):
        solution = solve_fleet(
            NODES, [edge(NODES, TRUTH, 0, 1, None, LOOSE)], clicks, wanted=[NODES[1]]
        )
        sizes.append(np.sqrt(np.trace(solution.nodes[NODES[1]].covariance[3:, 3:])))
    assert sizes[1] < 0.8 * sizes[0]


def test_three_clicks_alone_join_two_components():
    solution = solve_fleet(NODES, [], clicks_on(POINTS[:3]), wanted=[NODES[1]])
    assert solution.joined(*NODES)
    assert solution.nodes[NODES[1]].verdict == "plausible"
    assert position_errors(solution, NODES, TRUTH, 0)[1] < 1e-3
    assert solution.nodes[NODES[1]].covariance is not None
    assert all(judgement.used for judgement in solution.clicks.values())


def test_two_clicks_or_three_on_a_line_do_not_join():
    on_a_line = [np.array([0.2, 0.1, 0.0]) * k for k in (-2, 1, 3)]
    for points in (POINTS[:2], on_a_line):
        solution = solve_fleet(NODES, [], clicks_on(points))
        assert not solution.joined(*NODES)
        assert not any(judgement.used for judgement in solution.clicks.values())


def test_three_clicks_that_contradict_each_other_do_not_join():
    clicks = clicks_on(POINTS[:2]) + clicks_on(POINTS[2:3], first=2, offset=np.array([1.0, 1, 0]))
    assert not solve_fleet(NODES, [], clicks).joined(*NODES)


def test_clicks_made_in_different_views_of_a_pair_add_up():
    step = exp_se3(np.array([0.05, 0.1, 0, 0.3, 0.1, 0.1]))
    nodes = [view("a", k) for k in range(3)] + [view("b", k) for k in range(3)]
    truth = [TRUTH[0], TRUTH[0] @ step, TRUTH[0] @ step @ step]
    truth += [TRUTH[1], TRUTH[1] @ step, TRUTH[1] @ step @ step]
    tracks = [edge(nodes, truth, k, k + 1, None, kind="odometry") for k in (0, 1, 3, 4)]
    clicks = [click(nodes, truth, k, 3 + k, POINTS[k], None, k) for k in range(3)]
    assert not solve_fleet(nodes, tracks, clicks[:2]).joined(nodes[0], nodes[3])
    solution = solve_fleet(nodes, tracks, clicks, gauge=nodes[0])
    assert position_errors(solution, nodes, truth, 0).max() < 1e-2


def test_wrong_click_is_flagged_and_moves_little():
    rng = np.random.default_rng(2)
    good = clicks_on(POINTS, rng, depth_sigma=0.02)
    wrong = clicks_on(POINTS[:1] + 0.3, rng, first=9, offset=np.array([0.6, -0.4, 0.3]))
    tight = edge(NODES, TRUTH, 0, 1, rng)
    clean = solve_fleet(NODES, [tight], good)
    solution = solve_fleet(NODES, [tight], good + wrong)
    assert solution.clicks[9].outlier
    assert not any(solution.clicks[k].outlier for k in range(4))
    moved = solution.nodes[NODES[1]].T_root_camera - clean.nodes[NODES[1]].T_root_camera
    assert np.linalg.norm(moved[:3, 3]) < 0.01


def test_one_wrong_click_of_five_does_not_spoil_what_they_join():
    rng = np.random.default_rng(3)
    points = np.vstack((POINTS, [[-0.4, -0.3, 0.6]]))
    clicks = clicks_on(points[:4], rng, depth_sigma=0.02)
    clicks += clicks_on(points[4:], rng, first=4, offset=np.array([0.5, 0.5, -0.5]))
    solution = solve_fleet(NODES, [], clicks)
    assert solution.joined(*NODES)
    assert position_errors(solution, NODES, TRUTH, 0)[1] < 0.2
    assert [n for n, judgement in solution.clicks.items() if judgement.outlier] == [4]


def test_clicks_that_an_edge_grew_from_are_not_counted_again():
    rng = np.random.default_rng(4)
    grown = edge(NODES, TRUTH, 0, 1, rng, verdict="plausible", operator=True, grown=True)
    clicks = clicks_on(POINTS, rng)
    with_clicks, without = (
        solve_fleet(NODES, [grown], given, wanted=[NODES[1]]) for given in (clicks, [])
    )
    a, b = (s.nodes[NODES[1]] for s in (with_clicks, without))
    assert np.allclose(a.T_root_camera, b.T_root_camera)
    assert np.allclose(a.covariance, b.covariance)
    assert not any(judgement.used for judgement in with_clicks.clicks.values())
    assert all(np.isfinite(j.residual_m) for j in with_clicks.clicks.values())


def test_points_of_a_click_are_where_the_solution_says():
    solution = solve_fleet(NODES, [edge(NODES, TRUTH, 0, 1, None)], clicks_on(POINTS))
    assert max(judgement.residual_m for judgement in solution.clicks.values()) < 1e-3
    relative = solution.relative(*NODES)
    assert relative is not None
    assert np.allclose(relative.T_a_b, inverse(TRUTH[0]) @ TRUTH[1], atol=1e-3)
