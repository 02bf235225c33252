"""The operator's correspondences and the last error of a pair are weights of its turns."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling.pair_queue import note_promise, pick
from fleetpose.pose_server.scheduling.settings import Weights
from fleetpose.pose_server.scheduling.weights import live_clicks, pair_weight
from fleetpose.pose_server.state.pairs import PairRecord
from fleetpose.pose_server.state.site import Site
from tests.pose_server.scene import turned
from tests.pose_server.test_flows import (
    Forgetful,
    click,
    named,
    result,
    scene_with_points_to_click,
    site_of,
    work_off,
)

PAIR = ("r1", "r2")
PARTNERS = 5
clicks_and_errors = st.lists(
    st.tuples(st.integers(0, 6), st.floats(0.0, 1.0)), min_size=PARTNERS, max_size=PARTNERS
)


class Clicked(CorrespondenceStore):
    """A book with so many correspondences per pair."""

    def __init__(self, counts: dict[tuple[str, str], int]) -> None:
        super().__init__(Forgetful())
        self.counts = counts

    def of(self, a, b):
        item = SimpleNamespace
        return [
            SimpleNamespace(item=item(id=k, revision=0)) for k in range(self.counts.get((a, b), 0))
        ]


def weight(clicks: int = 0, error_m: float | None = None, verdict="verified", **record) -> float:
    site = Site(correspondences=Clicked({PAIR: clicks}), depth_m=10.0)
    last = None if error_m is None else PairResult(None, None, verdict, (), rmse_m=error_m)
    return pair_weight(site, PAIR, PairRecord(last=last, **record), "joining", 0.5)


@given(st.integers(0, 9), st.floats(0.0, 50.0))
def test_more_clicks_and_a_larger_error_never_weigh_less_and_both_are_bounded(clicks, error_m):
    here = weight(clicks, error_m)
    assert weight(clicks + 1, error_m) >= here and weight(clicks, error_m + 1.0) >= here
    most = (1.0 + Weights.clicks) * (1.0 + Weights.error)
    assert 1.0 <= here / weight() <= most * (1.0 + 1e-9)


def test_three_clicks_add_all_that_clicks_add_and_one_a_third():
    assert weight(3) == weight(9) == pytest.approx((1.0 + Weights.clicks) * weight())
    assert weight(1) == pytest.approx((1.0 + Weights.clicks / 3) * weight())


def test_the_last_error_counts_and_not_the_best_and_one_that_failed_has_none():
    poor, good = result(turned(1)), result(turned(1))
    assert weight(error_m=0.1, best=good) == pytest.approx(2.0 * weight(best=good))
    assert weight(error_m=0.1) == weight(error_m=0.1, best=poor)
    assert weight(error_m=0.1, verdict="rejected") == weight()


def test_clicks_that_the_images_contradict_add_nothing():
    site = Site(correspondences=Clicked({PAIR: 3}))
    record = PairRecord(heard={(0, 0): False, (1, 0): True})
    assert live_clicks(site, PAIR, record) == 2


@settings(deadline=None, max_examples=10)
@given(clicks_and_errors)
def test_turns_are_shared_by_clicks_and_errors_and_no_pair_starves(clicked):
    pairs = [("r0", f"r{k + 1}") for k in range(PARTNERS)]
    counts = dict(zip(pairs, (clicks for clicks, _ in clicked), strict=True))
    site = Site(correspondences=Clicked(counts), depth_m=10.0)
    for pair, (_, error_m) in zip(pairs, clicked, strict=True):
        site.pair(*pair).last = PairResult(None, None, "plausible", (), rmse_m=error_m)
    turns, rounds = Counter(), 300
    for a, b in pairs:
        for seq in range(2):  # one waits while the other is picked: the pair keeps its place
            note_promise(site, named(seq, a), named(seq, b), 0.5, 0.0)
    for _ in range(rounds):
        pair, views = pick(site, 0.0)
        turns[pair] += 1
        note_promise(site, *views, 0.5, 0.0)
    weights = {pair: pair_weight(site, pair, site.pairs[pair], "joining", 0.5) for pair in pairs}
    for pair in pairs:
        assert abs(turns[pair] / rounds - weights[pair] / sum(weights.values())) < 0.02
    assert site.pair_queue.max_wait_share <= 1.0 and set(turns) == set(pairs)


def test_a_pair_with_new_correspondences_is_next_and_weighs_more_from_then_on():
    T_true = turned(15)
    messages, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*messages)
    work_off(site)
    note_promise(site, named(0, "r1"), named(7, "r2"), 0.1, 0.0)
    for other in ("r3", "r4"):  # they wait for long and promise more
        note_promise(site, named(0, "r1"), named(0, other), 1.0, -100.0)
    line = next(line for line in site.pair_queue.lines.values() if PAIR in line)
    others = [pair for pair in line.waiting() if pair != PAIR]
    before = line.pick(0.0, busy=others)
    (outcome,) = pipeline.receive_update(site, click(1, points[0], T_true))
    assert outcome.accepted, outcome.reason
    after = line.pick(0.0, busy=others)
    assert before is not None and after is not None
    assert after.weight == pytest.approx(before.weight * (1.0 + Weights.clicks / 3))
    job = pipeline.urgent_job(site)
    assert job is not None and job.kind == "clicks"
    assert {job.i.name.robot, job.j.name.robot} == set(PAIR)
