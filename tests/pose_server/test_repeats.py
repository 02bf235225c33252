"""A place that repeats itself: what is doubted there, what is not, and that it is remembered."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fleetpose.pose_server.consistency.repetition import (
    believed,
    note_refuted,
    note_repetition,
    repetition,
)
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.geometry.structure import Structure
from fleetpose.pose_server.pose_graph.types import Edge, EdgeJudgement
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import ViewName
from tests.pose_server.test_telling import EPOCH, Forgetful

VERIFIED = PairResult(np.eye(4), np.eye(6), "verified", (), p_grave=0.001)
TWOFOLD = PairResult(np.eye(4), np.eye(6), "ambiguous", (), p_grave=0.5, twofold=True)


def view(robot: str) -> ViewName:
    return ViewName(robot=robot, epoch=EPOCH, seq=0)


def place(*results: PairResult) -> Site:
    """Robots of which each two were aligned with one of these results; the sure ones are edges."""
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    for k, result in enumerate(results):
        a, b = f"a{k}", f"b{k}"
        site.pair(a, b).stop(result, (view(a), view(b)), 0.0)
        if result.verdict == "verified":
            edge = Edge(
                view(a),
                view(b),
                np.eye(4),
                np.eye(6),
                p_grave=result.p_grave,
                structure=Structure(np.zeros(3), np.eye(3)),
            )
            site.edges[edge.key] = edge
    return site


def verdicts(site: Site) -> list[str]:
    return [edge.verdict for edge in believed(site)]


def test_a_single_twofold_pair_makes_no_place_doubtful():
    site = place(*[VERIFIED] * 4, TWOFOLD)
    assert repetition(site) == 0.0 and verdicts(site) == ["verified"] * 4


def test_where_pairs_are_twofold_what_had_no_rival_is_as_doubtful_as_the_place():
    site = place(*[VERIFIED] * 2, *[TWOFOLD] * 2)
    assert repetition(site) == 0.5 and verdicts(site) == ["plausible"] * 2
    assert all(edge.p_grave == 0.5 for edge in believed(site))
    assert all(edge.structure is None for edge in believed(site)), "no witness for each other"


def test_what_beat_its_rivals_or_was_clicked_is_believed_all_the_same():
    site = place(*[VERIFIED] * 3, *[TWOFOLD] * 3)
    first, second, third = site.edges
    site.edges[first] = replace(site.edges[first], singled_out=True)
    site.edges[second] = replace(site.edges[second], operator=True)
    assert {e.key: e.verdict for e in believed(site)} == {
        first: "verified",
        second: "verified",
        third: "plausible",
    }


def test_pairs_that_the_solution_refuted_are_remembered_until_they_are_aligned_anew():
    site = place(*[VERIFIED] * 4)
    wrong = list(site.edges)[:2]
    out = {key: EdgeJudgement(0.0, 99.0, True) for key in wrong}
    site.solution = SimpleNamespace(edges=out)
    note_refuted(site)
    assert repetition(site) == 0.5
    site.solution = SimpleNamespace(edges={})  # doubted edges are set aside by no solution
    note_refuted(site)
    assert repetition(site) == 0.5
    for key in wrong:
        site.pair(key[0].robot, key[1].robot).refuted = False
    assert repetition(site) == 0.0


def test_a_pair_that_joins_nothing_has_the_fleet_solved_anew_if_it_makes_the_place_doubtful():
    site = place(*[VERIFIED] * 2)
    believed(site)  # as a solve does
    note_repetition(site)
    assert not site.dirty
    for k in (7, 8):
        a, b = f"a{k}", f"b{k}"
        site.pair(a, b).stop(TWOFOLD, (view(a), view(b)), 0.0)
    note_repetition(site)
    assert site.dirty and verdicts(site) == ["plausible"] * 2
