"""The fleet solve: components, outliers, warm starts."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.types import SolveSettings
from tests.pose_server.fleet_makers import (
    click,
    edge,
    exp_se3,
    position_errors,
    ring,
    thing,
    view,
)

NODES = [view(f"r{k}") for k in range(8)]
TRUTH = ring(8)
WRONG = np.array([0.1, -0.4, 0.2, 0.8, 0.3, -0.6])
LEFT, MIDDLE, RIGHT = (thing(x) for x in (-0.8, 0.0, 0.8))
LIKELY = {"verdict": "plausible", "p_grave": 0.05}  # of an edge that is doubtful, not more


def solve(edges, **options):
    options.setdefault("gauge", NODES[0])
    return solve_fleet(NODES, edges, **options)


def neighbours(rng, **options):
    return [edge(NODES, TRUTH, k, (k + 1) % 8, rng, **options) for k in range(8)]


def second_neighbours(rng, **options):
    return [edge(NODES, TRUTH, k, (k + 2) % 8, rng, **options) for k in range(8)]


def together(solution):
    return {frozenset(node.robot for node in members) for members in solution.components.values()}


def test_ring_without_noise_is_exact_and_the_gauge_stays_at_the_identity():
    solution = solve(neighbours(None))
    assert np.allclose(solution.nodes[NODES[0]].T_root_camera, np.eye(4), atol=1e-9)
    for node, T in zip(NODES, TRUTH, strict=True):
        assert np.allclose(solution.nodes[node].T_root_camera, inverse(TRUTH[0]) @ T, atol=1e-6)
        assert solution.nodes[node].verdict == "verified"
        assert solution.nodes[node].root == NODES[0]


def test_ring_with_noise_ends_nearer_to_the_truth_than_a_chain():
    errors = {"ring": [], "chain": []}
    for seed in range(20):
        edges = neighbours(np.random.default_rng(seed))
        for name, used in (("ring", edges), ("chain", edges[:-1])):
            errors[name].append(position_errors(solve(used), NODES, TRUTH, 0).mean())
    assert np.mean(errors["ring"]) < 0.75 * np.mean(errors["chain"])
    assert np.mean(errors["ring"]) < 0.06


@pytest.mark.parametrize("warm", [False, True])
def test_wrong_verified_edge_in_a_rich_graph_is_flagged_and_moves_nobody(warm):
    rng = np.random.default_rng(1)
    right = neighbours(rng) + second_neighbours(rng)
    wrong = edge(NODES, TRUTH, 1, 5, rng, offset=WRONG)
    clean = solve(right)
    solution = solve([*right, wrong], previous=clean if warm else None)
    assert {key for key, j in solution.edges.items() if j.outlier} == {wrong.key}
    assert solution.edges[wrong.key].weight == 0 and not solution.edges[wrong.key].contested
    for node in NODES:
        moved = solution.nodes[node].T_root_camera - clean.nodes[node].T_root_camera
        assert np.abs(moved).max() < 1e-3
        assert solution.nodes[node].verdict == "verified"
    assert solution.judged != warm  # a new edge that a firm graph outvotes needs no judging of all


def test_outvoted_edges_lead_to_judging_all_anew_when_they_become_many():
    rng = np.random.default_rng(2)
    edges = neighbours(rng) + second_neighbours(rng)
    settings = SolveSettings(outvoted_limit=1)
    solution = solve(edges, settings=settings)
    judged = []
    for a, b in ((0, 4), (1, 5), (2, 6)):
        edges = [*edges, edge(NODES, TRUTH, a, b, rng, offset=WRONG)]
        solution = solve(edges, previous=solution, settings=settings)
        judged.append(solution.judged)
    assert judged == [False, True, False]  # the third is the first since all were judged
    assert sum(j.outlier for j in solution.edges.values()) == 3


def test_majority_that_arrives_later_overturns_an_early_wrong_edge():
    rng = np.random.default_rng(3)
    wrong = edge(NODES, TRUTH, 0, 4, rng, offset=WRONG)
    edges, solution = [wrong], solve([wrong])
    assert not solution.edges[wrong.key].outlier  # alone it closes no cycle
    for new in neighbours(rng) + second_neighbours(rng):
        edges = [*edges, new]
        solution = solve(edges, previous=solution)
    assert {key for key, j in solution.edges.items() if j.outlier} == {wrong.key}
    assert position_errors(solution, NODES, TRUTH, 0).max() < 0.1


@pytest.mark.parametrize("at_once", [False, True])
def test_a_majority_of_aliases_that_agree_with_each_other_proves_nothing_against_verified(at_once):
    rng = np.random.default_rng(4)
    right = neighbours(rng)
    turned = [TRUTH[0], *(TRUTH[(k + 3) % 8] for k in range(1, 8))]  # all but one by 135 deg
    aliases = [
        edge(NODES, turned, 0, b, rng, verdict="plausible", operator=True) for b in range(2, 7)
    ]
    solution = None
    for k in range(4 if at_once else 0, 5):
        solution = solve([*right, *aliases[: k + 1]], previous=solution)
    assert {key for key, j in solution.edges.items() if j.outlier} == {one.key for one in aliases}
    assert position_errors(solution, NODES, TRUTH, 0).max() < 0.15


def test_two_verified_edges_that_contradict_each_other_leave_nothing_verified():
    rng = np.random.default_rng(4)
    edges = [
        edge(NODES, TRUTH, 0, 1, rng),
        edge(NODES, TRUTH, 1, 2, rng),
        edge(NODES, TRUTH, 0, 2, rng, offset=WRONG),
    ]
    solution = solve(edges)
    assert sum(j.outlier for j in solution.edges.values()) == 1
    verdicts = [solution.nodes[node].verdict for node in NODES[:3]]
    assert verdicts[0] == "verified" and "ambiguous" in verdicts[1:]


def test_lone_plausible_edge_does_not_join_and_is_named():
    edges = [*neighbours(None)[:2], edge(NODES, TRUTH, 2, 3, None, verdict="plausible")]
    solution = solve(edges)
    assert frozenset({"r0", "r1", "r2"}) in together(solution)
    assert frozenset({"r3"}) in together(solution)
    (bridge,) = solution.bridges
    assert {bridge.root_a, bridge.root_b} == {NODES[0], NODES[3]}
    assert bridge.edges == (edges[2],)
    assert not solution.joined(NODES[0], NODES[3])


@pytest.mark.parametrize("verdict", ["ambiguous", "rejected"])
def test_unclear_edges_never_join(verdict):
    edges = [edge(NODES, TRUTH, k, k + 1, None, verdict=verdict) for k in range(3)]
    edges.append(edge(NODES, TRUTH, 0, 3, None, verdict="rejected", operator=True))
    assert len(together(solve(edges))) == len(NODES)


def plausible_pair(offset):
    rng = np.random.default_rng(5)
    return [
        edge(NODES, TRUTH, 0, 1, rng),
        edge(NODES, TRUTH, 2, 3, rng),
        edge(NODES, TRUTH, 1, 2, rng, **LIKELY, rests_on=LEFT),
        edge(NODES, TRUTH, 0, 3, rng, **LIKELY, rests_on=RIGHT, offset=offset),
    ]


def test_two_agreeing_plausible_edges_join_as_plausible():
    solution = solve(plausible_pair(None))
    assert frozenset({"r0", "r1", "r2", "r3"}) in together(solution)
    assert solution.bridges == ()
    assert solution.nodes[NODES[1]].verdict == "verified"
    assert solution.nodes[NODES[2]].verdict == solution.nodes[NODES[3]].verdict == "plausible"
    assert all(judgement.weight == 1 for judgement in solution.edges.values())


def test_two_disagreeing_plausible_edges_do_not_join():
    solution = solve(plausible_pair(WRONG))
    assert frozenset({"r0", "r1"}) in together(solution)
    (bridge,) = solution.bridges
    assert len(bridge.edges) == 2


def test_two_plausible_edges_of_robots_that_stood_still_are_one_piece_of_evidence():
    def joined(step_m):
        step = exp_se3(np.array([0, 0, 0, step_m, 0, 0]))
        nodes = [view("a", 0), view("a", 1), view("b", 0), view("b", 1)]
        truth = [TRUTH[0], TRUTH[0] @ step, TRUTH[1], TRUTH[1] @ step]
        edges = [
            edge(nodes, truth, 0, 1, None, kind="odometry"),
            edge(nodes, truth, 2, 3, None, kind="odometry"),
            edge(nodes, truth, 0, 2, None, **LIKELY, rests_on=LEFT),
            edge(nodes, truth, 1, 3, None, **LIKELY, rests_on=RIGHT),
        ]
        return solve_fleet(nodes, edges).joined(nodes[0], nodes[2])

    assert not joined(0.001)
    assert joined(0.5)


def test_triangle_of_plausible_edges_joins_only_if_it_closes():
    def joined(offset):
        edges = [
            edge(NODES, TRUTH, 0, 1, None, **LIKELY, rests_on=LEFT),
            edge(NODES, TRUTH, 1, 2, None, **LIKELY, rests_on=MIDDLE),
            edge(NODES, TRUTH, 2, 0, None, **LIKELY, rests_on=RIGHT, offset=offset),
        ]
        return frozenset({"r0", "r1", "r2"}) in together(solve(edges))

    assert joined(None)
    assert not joined(WRONG)


def test_plausible_alias_makes_what_an_operator_confirmed_neither_ambiguous_nor_wrong():
    edges = [
        edge(NODES, TRUTH, 0, 1, None),
        edge(NODES, TRUTH, 0, 2, None, verdict="plausible", operator=True),
        edge(NODES, TRUTH, 1, 2, None, verdict="plausible", offset=WRONG),
    ]
    solution = solve(edges)
    assert solution.edges[edges[2].key].outlier and not solution.edges[edges[1].key].contested
    assert solution.nodes[NODES[2]].verdict == "plausible"
    expected = inverse(TRUTH[0]) @ TRUTH[2]
    assert np.allclose(solution.nodes[NODES[2]].T_root_camera, expected, atol=1e-6)


def test_operator_edge_joins_though_only_plausible():
    solution = solve([edge(NODES, TRUTH, 0, 1, None, verdict="plausible", operator=True)])
    assert solution.joined(NODES[0], NODES[1])
    assert solution.nodes[NODES[1]].verdict == "plausible"


def test_components_are_kept_apart_and_rooted_at_the_gauge_or_the_first_robot():
    edges = [edge(NODES, TRUTH, 6, 7, None), edge(NODES, TRUTH, 0, 1, None)]
    newest = {node.robot: node for node in NODES[1:]}
    solution = solve(edges, gauge=NODES[1], newest=newest)
    assert next(iter(solution.components)) == NODES[1]
    assert set(solution.components[NODES[1]]) == set(NODES[:2])
    assert set(solution.components[NODES[6]]) == set(NODES[6:])
    assert solution.relative(NODES[0], NODES[7]) is None
    T_6_7 = solution.relative(NODES[6], NODES[7])
    assert T_6_7 is not None
    assert np.allclose(T_6_7.T_a_b, inverse(TRUTH[6]) @ TRUTH[7], atol=1e-6)


def test_relative_pose_says_through_whom():
    relative = solve(neighbours(None)[:4], gauge=NODES[2]).relative(NODES[0], NODES[4])
    assert relative is not None
    assert [node.robot for node in relative.path] == ["r0", "r1", "r2", "r3", "r4"]


def test_moving_the_gauge_keeps_the_solution():
    rng = np.random.default_rng(6)
    edges = neighbours(rng)
    first = solve(edges)
    second = solve(edges, gauge=NODES[3], previous=first)
    for node in NODES:
        T_0_3, T_0_x = (first.nodes[n].T_root_camera for n in (NODES[3], node))
        assert np.allclose(second.nodes[node].T_root_camera, inverse(T_0_3) @ T_0_x, atol=1e-4)


def test_removing_the_right_edges_gives_a_former_outlier_its_place_back():
    rng = np.random.default_rng(7)
    right = neighbours(rng) + second_neighbours(rng)
    other = edge(NODES, TRUTH, 1, 5, rng, offset=WRONG)
    solution = solve([*right, other])
    assert solution.edges[other.key].outlier
    solution = solve([other], previous=solution)
    assert solution.joined(NODES[1], NODES[5]) and not solution.edges[other.key].outlier


def test_no_edges_and_no_nodes_are_no_error():
    assert solve_fleet([], []).components == {}
    solution = solve([], newest={node.robot: node for node in NODES})
    assert len(solution.components) == len(NODES)
    assert np.allclose(solution.nodes[NODES[3]].T_root_camera, np.eye(4))


def test_edges_to_strangers_and_doubled_edges_are_refused():
    stranger = [*NODES, view("stranger")]
    strange = edge(stranger, [*TRUTH, np.eye(4)], 0, 8, None)
    with pytest.raises(ValueError, match="does not join two of the keyframes"):
        solve([strange])
    with pytest.raises(ValueError, match="given twice"):
        solve([neighbours(None)[0]] * 2)
    with pytest.raises(ValueError, match="not among the keyframes"):
        solve([], clicks=[click(stranger, [*TRUTH, np.eye(4)], 0, 8, np.ones(3), None, 1)])


def test_updates_of_a_solved_fleet_of_72_stay_right():
    nodes, truth, rng = [view(f"r{k:02d}") for k in range(72)], ring(72), np.random.default_rng(8)
    edges = {}
    for step in (1, 2, 3, 4, 5, 6):
        for k in range(72):
            if len(edges) < 400:
                edges[k, step] = edge(nodes, truth, k, (k + step) % 72, rng)
    solution = solve_fleet(nodes, list(edges.values()), gauge=nodes[0])
    for _ in range(3):
        solution = solve_fleet(nodes, list(edges.values()), gauge=nodes[0], previous=solution)
    assert position_errors(solution, nodes, truth, 0).max() < 0.1
