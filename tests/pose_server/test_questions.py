"""Which questions come first, and what they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.pose_graph.graph import solve_fleet
from fleetpose.pose_server.questions.ranking import PairFacts, rank_questions, standing
from tests.pose_server.fleet_makers import SIGMAS, edge, ring, view

NODES = [view(f"r{k}") for k in range(6)]
TRUTH = ring(6)
NEWEST = {node.robot: node for node in NODES}


def facts(i, j, chance=0.5, **more):
    return PairFacts(f"r{i}", f"r{j}", NODES[i], NODES[j], chance, **more)


def asked(edges, pairs, **options):
    solution = solve_fleet(NODES, edges, gauge=NODES[0], newest=NEWEST)
    questions = rank_questions(solution, NEWEST, pairs, 2.0, anchor="r0", **options)
    return [(question.i, question.j) for question in questions], questions


def test_likely_bridge_is_asked_first_though_another_pair_is_likelier():
    edges = [edge(NODES, TRUTH, 1, 2, None, verdict="plausible")]
    order, questions = asked(edges, [facts(0, 1, 1.0), facts(1, 2, 0.5), facts(0, 3, 0.9)])
    assert order[0] == ("r1", "r2")
    assert "nothing confirms it" in questions[0].reason


def test_joining_comes_before_sharpening_and_more_robots_before_fewer():
    edges = [
        edge(NODES, TRUTH, 0, 1, None, 10 * SIGMAS),
        edge(NODES, TRUTH, 3, 4, None),
        edge(NODES, TRUTH, 4, 5, None),
    ]
    order, questions = asked(edges, [facts(0, 1, 1.0), facts(1, 2), facts(2, 3), facts(0, 4)])
    assert order == [("r0", "r4"), ("r1", "r2"), ("r2", "r3"), ("r0", "r1")]
    assert "r3, r4, r5 to the fleet" in questions[0].reason
    assert all(question.gain > 0 for question in questions)


def test_a_robot_that_hangs_by_doubtful_links_is_asked_about_before_those_that_are_sure():
    edges = [
        edge(NODES, TRUTH, 0, 1, None),
        edge(NODES, TRUTH, 1, 2, None),
        edge(NODES, TRUTH, 0, 3, None, p_grave=0.1, operator=True),
    ]
    order, questions = asked(edges, [facts(0, 1), facts(1, 2), facts(0, 3)])
    assert order[0] == ("r0", "r3")
    assert "gravely wrong with a probability of 10%" in questions[0].reason
    _, questions = asked(edges, [facts(0, 1), facts(1, 2), facts(0, 3)], located_grave=0.2)
    assert all("gravely wrong" not in question.reason for question in questions)


def test_likely_overlap_decides_between_pairs_of_equal_worth():
    order, _ = asked([], [facts(0, 1, 0.2), facts(0, 2, 0.9), facts(0, 3, 0.5)])
    assert order == [("r0", "r2"), ("r0", "r3"), ("r0", "r1")]


def test_failed_tries_and_useless_correspondences_rank_a_pair_down():
    order, questions = asked(
        [], [facts(0, 1, 0.6, failed=2), facts(0, 2, 0.5), facts(0, 3, 0.6, correspondences=7)]
    )
    assert order == [("r0", "r2"), ("r0", "r1"), ("r0", "r3")]
    assert "Tried 2 times without success" in questions[1].reason
    assert "7 points have not sufficed" in questions[2].reason


def test_pair_that_lacks_one_click_comes_before_one_that_lacks_three():
    order, questions = asked([], [facts(0, 1), facts(0, 2, correspondences=2)])
    assert order[0] == ("r0", "r2")
    assert "2 of 3 points are there, 1 to go" in questions[0].reason


def test_second_question_about_the_same_two_components_is_worth_less():
    edges = [edge(NODES, TRUTH, 0, 1, None), edge(NODES, TRUTH, 3, 4, None)]
    order, _ = asked(edges, [facts(0, 3, 0.9), facts(1, 4, 0.8), facts(0, 5, 0.9)])
    assert order == [("r0", "r3"), ("r0", "r5"), ("r1", "r4")]


@pytest.mark.parametrize("more", [{"failed": 6}, {"in_vain": 1}, {"chance": 0.1}])
def test_unlikely_bridge_loses_its_precedence(more):
    edges = [edge(NODES, TRUTH, 0, 1, None, verdict="plausible")]
    order, _ = asked(edges, [facts(0, 1, **more), facts(0, 2, 0.5)])
    assert order[0] == ("r0", "r2")


def test_gain_is_the_stated_formula():
    _, (question,) = asked([], [facts(0, 1, 0.5)])
    assert np.isclose(question.gain, 0.5 * (2.0 * 0.97) / (6 * (0.5 * 3 + 0.5 * 2)))


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 4), st.floats(0, 1), st.integers(0, 9), st.integers(0, 3), st.booleans()
        ),
        min_size=5,
        max_size=5,
    )
)
def test_gain_is_never_negative_and_joining_comes_before_sharpening(known):
    edges = [edge(NODES, TRUTH, 0, 1, None, 20 * SIGMAS), edge(NODES, TRUTH, 1, 2, None)]
    pairs = [
        facts(i, k + 1, chance, correspondences=clicks, failed=failed, verified=verified)
        for k, (i, chance, clicks, failed, verified) in enumerate(known)
        if i < k + 1
    ]
    order, questions = asked(edges, pairs)
    assert all(question.gain > 0 for question in questions)
    joined = {"r0", "r1", "r2"}
    joins = [not {i, j} <= joined for i, j in order]
    assert joins == sorted(joins, reverse=True)


@pytest.mark.parametrize("edges", [[], [edge(NODES, TRUTH, 0, 1, None, 20 * SIGMAS)]])
@pytest.mark.parametrize("what", ["failed", "in_vain", "fruitless"])
def test_more_tries_never_raise_a_question(edges, what):
    if what == "fruitless" and not edges:
        return  # of pairs that clicks join there is none
    gains = []
    for tries in range(4):
        _, (question,) = asked(edges, [facts(0, 1, 0.6, **{what: tries})])
        gains.append(question.gain)
    assert gains == sorted(gains, reverse=True) and gains[0] > gains[-1]


def test_robot_too_unsure_to_be_located_comes_before_one_that_is():
    weak, good = np.full(6, 0.06), np.full(6, 0.01)
    edges = [edge(NODES, TRUTH, 0, 1, None, weak), edge(NODES, TRUTH, 0, 2, None, good)]
    edges += [edge(NODES, TRUTH, 2, k, None, good / 9) for k in (3, 4, 5)]
    order, _ = asked(edges, [facts(0, 2, 1.0), facts(0, 1, 0.3)])
    assert order == [("r0", "r1"), ("r0", "r2")]


def test_contradicted_robots_count_as_unknown():
    wrong = np.array([0.1, -0.4, 0.2, 0.8, 0.3, -0.6])
    edges = [edge(NODES, TRUTH, 0, 1, None), edge(NODES, TRUTH, 2, 1, None)]
    edges.append(edge(NODES, TRUTH, 0, 2, None, offset=wrong))
    before = standing(solve_fleet(NODES, edges[:2], gauge=NODES[0], newest=NEWEST), NEWEST, 2.0)
    after = standing(solve_fleet(NODES, edges, gauge=NODES[0], newest=NEWEST), NEWEST, 2.0)
    assert after.mean_sigma_m > before.mean_sigma_m
    assert after.joined == before.joined == {"r0", "r1", "r2"}


def test_clicks_beyond_a_verified_alignment_are_worth_little():
    edges = [edge(NODES, TRUTH, 0, 1, None, 20 * SIGMAS)]
    _, (verified,) = asked(edges, [facts(0, 1, 0.6, verified=True)])
    _, (plausible,) = asked(edges, [facts(0, 1, 0.6)])
    assert verified.gain < 0.2 * plausible.gain


def test_located_fleet_with_equal_sigmas_is_asked_nothing():
    edges = [edge(NODES, TRUTH, k, k + 1, None, np.full(6, 1e-4)) for k in range(5)]
    order, _ = asked(edges, [facts(k, k + 1, 1.0) for k in range(5)])
    assert order == []


def test_limit_and_unknown_robots_are_respected():
    stranger = PairFacts("r0", "zz", NODES[0], view("zz"), 1.0)
    order, _ = asked([], [stranger, facts(0, 1), facts(0, 2)], limit=1)
    assert len(order) == 1 and "zz" not in order[0]
    assert rank_questions(solve_fleet([], []), {}, [], 1.0) == []
