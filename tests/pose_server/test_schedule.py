"""Whose turn it is: shares, waiting, arrivals and departures."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.scheduling.weighted_round_robin import WeightedRoundRobin

weights = st.dictionaries(st.integers(0, 200), st.floats(0.05, 20.0), min_size=1, max_size=30)
PICKS = 1000


def line_of(weights: dict[int, float]) -> WeightedRoundRobin[int]:
    line: WeightedRoundRobin[int] = WeightedRoundRobin()
    for key, weight in weights.items():
        line.put(key, weight, 0.0)
    return line


@settings(deadline=None)
@given(weights)
def test_shares_are_proportional_to_weights(weights):
    line = line_of(weights)
    picks = [line.pick(0.0).key for _ in range(PICKS)]
    total = sum(weights.values())
    for key, weight in weights.items():
        assert abs(picks.count(key) / PICKS - weight / total) < 0.05
    off = sum(abs(picks.count(key) / PICKS - w / total) for key, w in weights.items()) / 2
    assert off < 0.05


@settings(deadline=None)
@given(weights, st.integers(0, 10**6), st.floats(0.0, 3.0))
def test_nobody_waits_longer_than_the_bound_whoever_comes_goes_or_changes(weights, seed, step_s):
    chance = random.Random(seed)
    line = line_of(weights)
    waiting = dict.fromkeys(weights, 0)
    for turn in range(400):
        now_s = turn * step_s
        if chance.random() < 0.1:
            newcomer = chance.randrange(1000, 2000)
            line.put(newcomer, chance.uniform(0.05, 20.0), now_s)
            waiting.setdefault(newcomer, 0)
        if chance.random() < 0.1 and len(waiting) > 1:
            gone = chance.choice(sorted(waiting))
            line.remove(gone)
            del waiting[gone]
        if chance.random() < 0.1:
            line.put(chance.choice(sorted(waiting)), chance.uniform(0.05, 20.0), now_s)
        picked = line.pick(now_s)
        assert picked.waited_picks == waiting[picked.key]
        assert picked.waited_picks <= picked.most_picks
        waiting = {key: 0 if key == picked.key else n + 1 for key, n in waiting.items()}
    assert len(line) == len(waiting)
    assert all(key in line for key in waiting)


def test_whoever_waits_grows():
    line = line_of({1: 1.0, 2: 1.0})
    first = line.pick(0.0)
    second = line.pick(30.0)
    assert {first.key, second.key} == {1, 2}
    assert first.weight == pytest.approx(1.0)
    assert second.weight == pytest.approx(4.0)
    assert second.waited_s == pytest.approx(30.0)


def test_who_is_busy_is_passed_over_and_makes_up_for_it():
    line = line_of({1: 5.0, 2: 1.0})
    assert {line.pick(0.0, busy={1}).key for _ in range(3)} == {2}
    assert line.pick(0.0, busy={1, 2}) is None
    picks = [line.pick(0.0).key for _ in range(15)]
    assert picks.count(1) == 15  # 18 picks, of which 15 are its share


def test_nobody_in_line_is_no_turn_and_strangers_may_be_withdrawn():
    line: WeightedRoundRobin[str] = WeightedRoundRobin()
    line.remove("nobody")
    assert line.pick(0.0) is None
    with pytest.raises(ValueError, match="weight"):
        line.put("r1", 0.0, 0.0)
    line.put("r1", 1.0, 0.0)
    line.remove("r1")
    assert line.pick(0.0) is None
    assert not len(line)


def test_a_long_line_stays_itself_as_keys_come_and_go():
    chance, line, here = random.Random(1), WeightedRoundRobin(), {}
    for number in range(300):
        line.put(number, 1.0 + number % 7, 0.0)
        here[number] = 1.0 + number % 7
        if number % 3 == 0:
            gone = chance.choice(sorted(here))
            line.remove(gone)
            del here[gone]
    total = sum(here.values())
    picks = [line.pick(0.0) for _ in range(20 * len(here))]
    assert all(one.total == pytest.approx(total) for one in picks)
    assert all(one.weight == here[one.key] for one in picks)
    assert {one.key for one in picks} == set(here)
