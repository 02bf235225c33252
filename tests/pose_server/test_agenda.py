"""Which pairs are aligned next: those that may join first, and only what may see the same."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling import pair_queue, proposals
from fleetpose.pose_server.scheduling.pair_queue import note_promise, pick
from fleetpose.pose_server.scheduling.proposals import (
    LEAST_OVERLAP,
    by_poses,
    expected_overlaps,
    to_compare,
)
from fleetpose.pose_server.state.pairs import Agenda, PairStatus
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.protocol.codec import pack
from tests.pose_server.scene import descriptors, pair_of_views, turned, view, walls
from tests.pose_server.test_flows import ENCODING, Forgetful, named, site_of

COVARIANCE = np.eye(6) * 1e-6


def strangers(count: int) -> Site:
    """Robots of which no two views look alike, and nothing is known of where they are."""
    rng = np.random.default_rng(1)
    return site_of(
        *(
            view(rng, f"r{k}", walls(rng, 300), descriptors(rng, 300), np.eye(4))
            for k in range(count)
        )
    )


def told(site: Site) -> Site:
    """The site once its views were laid beside each other."""
    pipeline.solve(site, 0.0)
    while pair_queue.compare_some(site, 0.0):
        pass
    return site


def standing_at(*yaws_deg: float) -> Site:
    """Robots whose poses are known: side by side, turned by so much."""
    site = strangers(len(yaws_deg))
    truth = [turned(yaw) for yaw in yaws_deg]
    for k in range(1, len(truth)):
        T = inverse(truth[0]) @ truth[k]
        site.link(Edge(named(0, "r0"), named(0, f"r{k}"), T, COVARIANCE, "verified"))
    return told(site)


def line_of(site: Site, a: str, b: str) -> str | None:
    return next((name for name, line in site.pair_queue.lines.items() if (a, b) in line), None)


def test_views_that_look_alike_may_join_and_others_are_unlikely():
    rng = np.random.default_rng(3)
    alike = pair_of_views(rng, turned(10))
    other = view(rng, "r3", walls(rng, 800), descriptors(rng, 800), np.eye(4))
    site = told(site_of(*alike, other))
    assert line_of(site, "r1", "r2") == "joining"
    assert line_of(site, "r1", "r3") == line_of(site, "r2", "r3") == "unlikely"
    pair, views = pick(site, 1.0)
    assert pair == ("r1", "r2")
    assert {one.robot for one in views} == {"r1", "r2"}
    assert "may join" in site.pair_queue.picked and "r1 - r2" in site.pair_queue.picked


def test_of_a_large_fleet_only_what_the_index_finds_alike_is_compared(monkeypatch):
    monkeypatch.setattr(proposals, "_ALL_COMPARED", 5)
    monkeypatch.setattr(proposals, "MOST_ALIKE", 2)
    rng = np.random.default_rng(3)
    others = [
        view(rng, f"s{k}", walls(rng, 300), descriptors(rng, 300), np.eye(4)) for k in range(20)
    ]
    site = told(site_of(*others, *pair_of_views(rng, turned(10))))
    assert line_of(site, "r1", "r2") == "joining"
    compared = [pair for pair in site.pairs if "r2" in pair]
    assert ("r1", "r2") in compared and len(compared) == 2


def test_where_poses_are_known_only_what_sees_the_same_is_worth_an_alignment():
    site = standing_at(0.0, 15.0, 170.0)
    assert line_of(site, "r0", "r1") == "sharpening"
    assert line_of(site, "r0", "r2") is None and line_of(site, "r1", "r2") is None
    assert set(by_poses(site, named(0, "r0"))) == {named(0, "r1")}
    assert to_compare(site, named(0, "r0")) == []


@pytest.mark.parametrize(("yaw_deg", "least", "most"), [(0.0, 0.99, 1.0), (90.0, 0.0, 0.0)])
def test_expected_overlap_is_whole_for_the_same_place_and_none_for_another_way(
    yaw_deg, least, most
):
    site = standing_at(0.0, yaw_deg)
    (overlap,) = expected_overlaps(site, named(0, "r0"), [named(0, "r1")])
    assert least <= overlap <= most


def test_expected_overlap_is_the_same_both_ways_and_falls_with_the_angle():
    overlaps = []
    for yaw in (5.0, 15.0, 25.0):
        site = standing_at(0.0, yaw)
        (there,) = expected_overlaps(site, named(0, "r0"), [named(0, "r1")])
        (back,) = expected_overlaps(site, named(0, "r1"), [named(0, "r0")])
        assert there == pytest.approx(back, abs=0.2)
        overlaps.append(there)
    assert overlaps == sorted(overlaps, reverse=True)
    assert overlaps[0] > LEAST_OVERLAP


def test_pairs_that_others_joined_no_longer_wait_to_join():
    site = told(strangers(3))
    for k in (1, 2):
        note_promise(site, named(0, "r0"), named(0, f"r{k}"), 0.9, 0.0)
    assert line_of(site, "r0", "r1") == line_of(site, "r0", "r2") == "joining"
    site.link(Edge(named(0, "r0"), named(0, "r1"), turned(15), COVARIANCE, "verified"))
    told(site)
    assert line_of(site, "r0", "r1") == "sharpening"
    assert line_of(site, "r0", "r2") == "joining"


def test_few_views_of_two_robots_wait_at_a_time_and_the_best_stay():
    site = told(strangers(2))
    rng = np.random.default_rng(2)
    for seq in range(1, 40):
        message = view(rng, "r1", walls(rng, 50), descriptors(rng, 50), np.eye(4), seq=seq)
        site.views.keep(open_view(pack(message), ENCODING, 0.0))
        note_promise(site, named(0, "r0"), named(seq, "r1"), seq / 40, 0.0)
    promises = site.pair("r0", "r1").untried.values()
    assert len(promises) <= 8 and min(promises) > 0.7


def test_skipped_pairs_never_wait():
    rng = np.random.default_rng(3)
    site = told(site_of(*pair_of_views(rng, turned(10)), skip=frozenset({("r1", "r2")})))
    assert line_of(site, "r1", "r2") is None
    assert ("r1", "r2") in site.pairs  # the matrix and the questions know it
    assert pick(site, 1.0) is None


def test_an_empty_site_has_nothing_to_pick():
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    pair_queue.update_priorities(site, 0.0)
    assert pick(site, 0.0) is None and not pair_queue.compare_some(site, 0.0)


FAILED = PairResult(None, None, "rejected", ())
ACTS = {
    "clicks": lambda record: record.make_due("clicks"),
    "search": lambda record: record.make_due("search"),
    "nothing": lambda record: record.make_due("nothing"),
    "start": lambda record: record.start(),
    "start clicks": lambda record: record.start("clicks"),
    "stop": lambda record: record.stop(FAILED, (named(0, "r1"), named(0, "r2")), 0.0),
    "stop clicks": lambda record: record.stop(
        FAILED, (named(0, "r1"), named(0, "r2")), 0.0, "clicks"
    ),
}


@given(st.lists(st.tuples(st.integers(0, 3), st.sampled_from(sorted(ACTS))), max_size=30))
def test_the_agenda_holds_the_pairs_that_a_look_at_all_would_find(acts):
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    for k, act in acts:
        ACTS[act](site.pair("r1", f"s{k}"))
    at = {pair: record.status for pair, record in site.pairs.items()}
    agenda = site.agenda
    assert agenda.running == {pair for pair, status in at.items() if status.running}
    aligned = {p for p, s in at.items() if "clicks" in s.at_work}
    assert set(agenda.clicks) == {p for p, s in at.items() if s.due == "clicks"} - aligned
    assert set(agenda.search) == {p for p, s in at.items() if s.due == "search" and not s.running}
    assert set(agenda.tried) == {p for p, r in site.pairs.items() if r.last is not None}


def test_of_changed_clicks_the_first_are_aligned_first():
    agenda, idle = Agenda(), PairStatus(due="clicks")
    for pair in (("r2", "r3"), ("r1", "r2"), ("r2", "r3")):
        agenda.note(pair, idle)
    assert list(agenda.clicks) == [("r2", "r3"), ("r1", "r2")]
