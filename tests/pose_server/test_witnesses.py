"""Independent witnesses: copies of one observation join nothing, and doubts add up on the way."""

import numpy as np
import pytest

from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose, transform
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph import report
from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.pose_graph.witnesses import all_grave, independent, some_grave
from tests.pose_server.fleet_makers import edge, exp_se3, ring, thing, view

NODES = [view(f"r{k}") for k in range(8)]
TRUTH = ring(8)
LEFT, MIDDLE, RIGHT = (thing(x) for x in (-0.8, 0.0, 0.8))
TURNED = make_pose(exp_so3(np.array([0.0, np.pi, 0.0])), np.zeros(3))


def solve(edges, nodes=NODES):
    return solve_fleet(nodes, edges, gauge=nodes[0])


def doubtful(truth, a, b, rests_on, p_grave=0.05):
    return edge(NODES, truth, a, b, None, verdict="plausible", p_grave=p_grave, rests_on=rests_on)


def test_structures_lie_apart_in_whatever_frame_they_are_told():
    rng = np.random.default_rng(0)
    T = exp_se3(rng.normal(size=6))
    for points, apart in ((RIGHT, True), (thing(-0.75), False)):
        for frame in (np.eye(4), T):
            one, other = (Structure.of(transform(frame, p)) for p in (LEFT, points))
            assert one.apart(other) is other.apart(one) is apart
    moved = Structure.of(LEFT).seen_from(T)
    assert np.allclose(moved.centre, Structure.of(transform(T, LEFT)).centre)
    assert moved.apart(Structure.of(transform(T, RIGHT)))


def test_what_an_edge_rests_on_must_be_known_to_make_it_a_witness():
    one, other = Structure.of(LEFT), Structure.of(RIGHT)
    assert independent([one, other])
    assert not independent([one, other, Structure.of(thing(0.7))])
    assert not independent([one, None])


def test_agreement_is_worth_what_aliases_that_always_agree_leave_of_it():
    assert all_grave([0.1, 0.1]) == pytest.approx(0.01 / (0.01 + 0.81))
    assert some_grave([0.1, 0.1]) == pytest.approx(all_grave([0.1, 0.1]))
    for count in range(1, 6):
        assert all_grave([0.5] * count) == pytest.approx(0.5)
    assert some_grave([0.1] * 3) > all_grave([0.1] * 3)
    assert all_grave([1.0, 0.0]) == some_grave([1.0, 0.0]) == 1.0


def neighbours_and(*plausible):
    """r0 and r1 hang together, r4 and r5 do; plausible edges between."""
    return [edge(NODES, TRUTH, 0, 1, None), edge(NODES, TRUTH, 4, 5, None), *plausible]


@pytest.mark.parametrize(("second", "joined"), [(thing(-0.78), False), (RIGHT, True)])
def test_two_edges_on_one_structure_are_one_witness(second, joined):
    edges = neighbours_and(doubtful(TRUTH, 0, 4, LEFT), doubtful(TRUTH, 1, 5, second))
    solution = solve(edges)
    assert solution.joined(NODES[0], NODES[4]) is joined
    if joined:
        assert solution.nodes[NODES[4]].verdict == "plausible"
        assert solution.nodes[NODES[4]].p_grave == pytest.approx(all_grave([0.05, 0.05]), abs=2e-3)
    else:
        assert len(solution.bridges[0].edges) == 2  # it is asked about


def test_a_third_edge_that_repeats_the_first_makes_two_that_are_no_witnesses_none_better():
    edges = neighbours_and(
        doubtful(TRUTH, 0, 4, LEFT, 0.2),
        doubtful(TRUTH, 1, 5, RIGHT, 0.2),
        doubtful(TRUTH, 1, 4, thing(-0.77), 0.2),
    )
    assert not solve(edges).joined(NODES[0], NODES[4])  # two of them: 6 %
    edges[-1] = doubtful(TRUTH, 1, 4, MIDDLE, 0.2)
    assert solve(edges).joined(NODES[0], NODES[4])  # three of them: 1.5 %


def test_courtyard_of_two_alike_wings_joins_nobody_who_sees_one_wing_from_two_places():
    """r0 sees the south wing, r1 and r2 the north one: all three are laid over one wing, and agree
    in a cycle that is perfectly consistent and half a turn wrong.
    """
    alias = [TRUTH[0], *(TURNED @ T for T in TRUTH[1:])]
    cycle = [
        doubtful(alias, 0, 1, LEFT),
        doubtful(alias, 1, 2, transform(TURNED, LEFT)),
        doubtful(alias, 0, 2, thing(-0.77)),
    ]
    solution = solve(cycle)
    assert all(len(members) == 1 for members in solution.components.values())
    assert {frozenset((b.root_a.robot, b.root_b.robot)) for b in solution.bridges} == {
        frozenset(pair) for pair in (("r0", "r1"), ("r1", "r2"), ("r0", "r2"))
    }


@pytest.mark.parametrize("count", [2, 3, 6])
def test_a_place_that_is_symmetric_as_a_whole_joins_nobody_however_many_agree(count):
    alias = [*TRUTH[:4], *(TURNED @ T for T in TRUTH[4:])]
    rigid = [edge(NODES, TRUTH, k, k + 1, None) for k in (0, 1, 2, 4, 5, 6)]
    ends = [(0, 4), (1, 5), (2, 6), (3, 7), (0, 5), (1, 6)][:count]
    between = [doubtful(alias, a, b, thing(0.5 * k - 1.2), 0.5) for k, (a, b) in enumerate(ends)]
    solution = solve([*rigid, *between])
    assert not solution.joined(NODES[0], NODES[4])
    assert len(solution.bridges[0].edges) == count


def test_doubts_add_up_along_a_chain_and_a_surer_way_makes_up_for_them():
    chain = [edge(NODES, TRUTH, k, k + 1, None, p_grave=0.02) for k in range(4)]
    grave = [solve(chain).nodes[node].p_grave for node in NODES[:5]]
    assert grave == pytest.approx([1 - 0.98**k for k in range(5)], abs=1e-6)
    surer = [*chain, edge(NODES, TRUTH, 0, 3, None, p_grave=0.001)]
    found = solve(surer).nodes
    assert found[NODES[3]].p_grave == pytest.approx(0.001, abs=1e-6)
    assert found[NODES[4]].p_grave == pytest.approx(1 - 0.999 * 0.98, abs=1e-6)


@pytest.mark.parametrize(("second", "sure"), [(RIGHT, True), (thing(-0.77), False)])
def test_a_way_that_rests_on_other_structure_confirms_a_doubtful_edge_and_a_copy_does_not(
    second, sure
):
    doubted = edge(NODES, TRUTH, 0, 1, None, p_grave=0.03, rests_on=LEFT)
    around = [
        edge(NODES, TRUTH, 0, 2, None, p_grave=0.03, rests_on=second),
        edge(NODES, TRUTH, 1, 2, None, p_grave=0.03, rests_on=second),
    ]
    (node,) = (solve([doubted, *around]).nodes[NODES[1]],)
    expected = all_grave([0.03, 1 - 0.97**2]) if sure else 0.03
    assert node.p_grave == pytest.approx(expected, abs=1e-6)


def test_a_robots_own_motion_leads_to_a_second_witness():
    nodes = [view("a", 0), view("a", 1), view("b", 0)]
    edges = [
        edge(nodes, TRUTH, 0, 1, None, kind="odometry"),
        edge(nodes, TRUTH, 0, 2, None, p_grave=0.03, rests_on=LEFT),
        edge(nodes, TRUTH, 1, 2, None, p_grave=0.03, rests_on=RIGHT),
    ]
    assert solve(edges, nodes).nodes[nodes[2]].p_grave < 0.002


def test_an_edge_that_is_set_aside_makes_nobody_surer():
    rng = np.random.default_rng(1)
    right = [edge(NODES, TRUTH, k, (k + 1) % 8, rng, p_grave=0.01) for k in range(8)]
    right += [edge(NODES, TRUTH, k, (k + 2) % 8, rng, p_grave=0.01) for k in range(8)]
    wrong = np.array([0.1, -0.4, 0.2, 0.8, 0.3, -0.6])
    alias = edge(NODES, TRUTH, 0, 4, rng, offset=wrong, p_grave=1e-6)
    solution = solve([*right, alias])
    assert solution.edges[alias.key].outlier
    assert solution.nodes[NODES[4]].p_grave == pytest.approx(1 - 0.99**2, abs=1e-6)


def test_what_is_known_of_an_edge_is_told_from_its_other_end_as_well():
    one = doubtful(TRUTH, 0, 4, LEFT)
    assert one.structure is not None
    in_world = one.structure.seen_from(TRUTH[0])
    T_4_0 = inverse(TRUTH[4]) @ TRUTH[0]
    assert np.allclose(one.structure.seen_from(T_4_0).seen_from(TRUTH[4]).centre, in_world.centre)


def between(*p_grave):
    """r0, r1 and r2 hang together, r4, r5 and r6 do; links between that say the same."""
    sure = [edge(NODES, TRUTH, a, b, None) for a, b in ((0, 1), (1, 2), (4, 5), (5, 6))]
    pairs = ((0, 4), (1, 5), (2, 6))
    rests_on = thing(0.0)  # on the same: none is a witness for another
    return sure + [
        edge(
            NODES, TRUTH, a, b, None, p_grave=p, rests_on=rests_on,
            verdict="verified" if p < 0.03 else "plausible",
        )
        for (a, b), p in zip(pairs, p_grave, strict=False)
    ]  # fmt: skip


def chance_of(solution, node):
    return solution.nodes[NODES[node]].p_grave


def test_a_lone_sure_link_among_links_that_doubt_is_doubted():
    alone, doubted = (chance_of(solve(between(0.002, *more)), 5) for more in ((), (0.5, 0.8)))
    assert alone < 0.03
    assert doubted > 0.05


def test_two_sure_links_are_not_doubted_for_a_third_that_is_not():
    assert chance_of(solve(between(0.002, 0.002, 0.8)), 5) < 0.03


def test_doubt_reaches_everybody_beyond_the_link_and_nobody_before_it():
    solution = solve(between(0.002, 0.5, 0.8))
    assert all(chance_of(solution, node) > 0.05 for node in (4, 5, 6))
    assert all(chance_of(solution, node) < 0.03 for node in (1, 2))


def test_who_is_held_by_nothing_that_is_used_is_not_vouched_for(monkeypatch):
    """Rounds of splitting may run out before a node is let go whose only link was found wrong."""
    monkeypatch.setattr(report, "along_surest_ways", lambda *_: {0: 0.0})
    solution = solve([edge(NODES, TRUTH, 0, 1, None)])
    assert chance_of(solution, 0) == 0.0
    assert chance_of(solution, 1) == 1.0
