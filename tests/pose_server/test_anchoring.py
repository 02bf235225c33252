"""The fleet's origin: it stays, is given up when the fleet has left it, and is taken again; without
network and workers.
"""

from dataclasses import replace

import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.consistency.anchoring import PATIENCE_S, note_anchor
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.frontend import localization
from fleetpose.pose_server.persistence.graph_store import Graph
from fleetpose.pose_server.persistence.restore import restored_site
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import ViewName
from tests.pose_server.scene import EPOCH
from tests.pose_server.test_doubts import (
    HALL,
    LATER,
    OTHER_HALL,
    PLACES,
    alarms,
    fleet,
    receive,
    seen,
    state_of,
)
from tests.pose_server.test_flows import site_of, work_off


def move_all(site: Site, hall: int, epoch: str, first_s: float) -> None:
    """All robots are switched off, carried to a hall, and switched on; the server stays."""
    for name, robot in site.robots.items():
        for life in list(robot.epochs):
            pipeline.receive_token(site, name, life, False)
    views = [seen(name, int(first_s), hall=hall, epoch=epoch) for name in sorted(site.robots)]
    receive(site, *views)
    note_anchor(site, first_s)


def pass_time(site: Site, from_s: float, hall: int, epoch: str) -> float:
    """Seconds in which all robots stand where they are, until the fleet has waited long enough."""
    for second in range(int(from_s) + 1, int(from_s + PATIENCE_S) + 2):
        receive(site, *(seen(name, second, hall=hall, epoch=epoch) for name in sorted(site.robots)))
        note_anchor(site, float(second))
        work_off(site)
        pipeline.note_components(site)
    return float(int(from_s + PATIENCE_S) + 1)


def test_a_fleet_carried_to_another_hall_gets_a_new_origin_and_the_old_one_back():
    site = fleet()
    first, revision = site.gauge, site.gauge_revision
    old = set(site.keyframes())
    move_all(site, OTHER_HALL, LATER, 10.0)
    assert not state_of(site, "r2", 10.0).pose.located and site.gauge == first
    now_s = pass_time(site, 10.0, OTHER_HALL, LATER)
    assert site.gauge != first and site.gauge_revision > revision
    assert all(state_of(site, name, now_s).why_not == "" for name in PLACES)
    assert any("sees the fleet's old place any more" in event for event in site.events)
    assert old <= set(site.keyframes()) and site.solution.nodes[first].root not in {
        site.solution.nodes[site.gauge].root
    }
    second, revision = site.gauge, site.gauge_revision
    move_all(site, HALL, "2" * 12, 30.0)
    now_s = pass_time(site, 30.0, HALL, "2" * 12)
    assert site.gauge == first and site.gauge_revision > revision
    assert second in site.keyframes()
    assert all(state_of(site, name, now_s).why_not == "" for name in PLACES)


def test_a_robot_that_comes_back_to_the_old_hall_alone_is_found_on_its_map():
    site = fleet()
    old = site.gauge
    move_all(site, OTHER_HALL, LATER, 10.0)
    pass_time(site, 10.0, OTHER_HALL, LATER)
    new = site.gauge
    receive(site, seen("r3", 20, epoch=LATER))
    assert site.joined(site.robots["r3"].track.newest.view, old) and site.gauge == new
    assert "sees a place that the fleet has left" in state_of(site, "r3", 20.0).why_not
    assert not alarms(site) and state_of(site, "r2", 17.0).why_not == ""


def test_the_origin_stays_while_one_robot_sees_its_place():
    site = fleet()
    first = site.gauge
    (stays, *_) = others = [name for name in PLACES if name != site.anchor]
    gone = [site.anchor, *others[1:]]
    for name in gone:
        pipeline.receive_token(site, name, EPOCH, False)
    for second in range(10, 20):
        moved = (seen(n, second, hall=OTHER_HALL, epoch=LATER) for n in gone)
        receive(site, *moved, seen(stays, second))
        note_anchor(site, float(second))
    assert site.gauge == first and state_of(site, stays, 19.0).why_not == ""
    assert "the anchor, but where it is now" in state_of(site, gone[0], 19.0).why_not


def test_a_fleet_of_which_nothing_is_heard_keeps_its_origin():
    site = fleet()
    first = site.gauge
    for second in range(100):
        note_anchor(site, float(second))
    assert site.gauge == first


def test_an_anchor_that_nobody_has_seen_is_named():
    site = site_of()
    site.anchor = site.anchoring.asked = "r11"
    receive(site, seen("r1", 0), seen("r2", 0))
    for second in range(5):
        note_anchor(site, float(second))
    said = "no robot called r11 has been seen, and it is to be the anchor; known: r1, r2"
    assert said in state_of(site, "r1", 1.0).why_not
    assert sum(said in event for event in site.events) == 1
    assert alarms(site) == {("r11", "anchor")}


def test_an_anchor_of_an_earlier_time_that_is_not_there_is_given_up():
    site = site_of()
    site.anchor = "r11"  # as the journal says; nobody asked for it
    receive(site, seen("r1", 0), seen("r2", 0))
    assert state_of(site, "r1", 0.0).why_not
    for second in range(5):
        note_anchor(site, float(second))
    assert state_of(site, "r1", 1.0).why_not == "" and site.anchor == "r1"
    assert site.gauge_revision == 1 and not alarms(site)


def test_a_robot_alone_is_told_that_it_is_alone():
    site = site_of()
    receive(site, seen("r1", 0))
    assert "the only robot so far" in state_of(site, "r1", 0.5).why_not
    receive(site, seen("r2", 0, hall=OTHER_HALL))
    assert "no two robots are joined" in state_of(site, "r1", 0.5).why_not


def test_another_anchor_after_a_restart_raises_the_revision_and_the_same_one_does_not(tmp_path):
    journal = Journal(tmp_path / "journal.sqlite3")
    journal.note(anchor="r1", gauge_revision="4")
    same, other = (restored_site(journal, Graph(), anchor=anchor) for anchor in ("r1", "r3"))
    assert (same.anchor, same.gauge_revision) == ("r1", 4)
    assert (other.anchor, other.gauge_revision) == ("r3", 5)
    assert restored_site(journal, Graph()).anchor == "r1"


@pytest.mark.parametrize("covered", [False, True], ids=["walks", "covered"])
def test_an_old_map_is_not_forgotten_for_what_is_seen_since(monkeypatch, covered):
    """New keyframes are all in another component than the first, or each in one of its own."""
    monkeypatch.setattr(localization, "MOST_KEYFRAMES", 4)
    site = fleet(("r1", "r2"))
    site.gauge, robot = None, site.robots["r1"]
    (old,) = robot.track.keyframes
    new = [ViewName(robot="r1", epoch=LATER, seq=seq) for seq in range(8)]
    for view in new:
        site.views.keep(replace(site.views[old], name=view))
        root = view if covered else new[0]
        site.solution.nodes[view] = replace(site.solution.nodes[old], root=root)
        localization.new_keyframe(site, robot, view)
    assert robot.track.keyframes == [old, *new[-3:]]
