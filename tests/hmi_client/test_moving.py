"""Points that are moved, and views that are held to do so."""

import pytest
from hmi_fakes import EPOCH, fleet, view

from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.messages import Correspondence, PairCorrespondences, Receipts, Rejection

A, B = (10.0, 20.0), (30.0, 40.0)


@pytest.fixture
def session():
    s = OperatorSession("anna", clock=lambda: 100.0)
    s.on_fleet(fleet(6))
    return s


def show(session, robot):
    session.on_picture(Picture(view(robot), b"jpeg", 1, session.clock()))


def receipts(session, n, *rejected):
    return Receipts(
        operator="anna",
        session=session.selection().session,
        n=n,
        rejections=tuple(Rejection(n=k, reason="it was changed meanwhile") for k in rejected),
        server_epoch=EPOCH,
    )


def moved_set(pixel_j, revision):
    item = Correspondence(
        id=4,
        operator="bob",
        view_i=view("r1"),
        view_j=view("r2"),
        pixel_i=A,
        pixel_j=pixel_j,
        status="accepted",
        revision=revision,
    )
    return PairCorrespondences(i="r1", j="r2", revision=revision, items=(item,), server_epoch=EPOCH)


def test_a_move_names_the_revision_it_was_made_on_and_can_be_undone(session):
    session.select("r1", "r2")
    session.on_correspondences(moved_set(B, 3))
    session.move(("r1", "r2"), 4, 1, (31.0, 41.0))
    [update] = session.open_updates()
    assert (update.action, update.correspondence, update.base_revision) == ("move", 4, 3)
    assert tuple(update.pixel_i) == A and tuple(update.pixel_j) == (31.0, 41.0)
    assert [(e.status, e.pick.pixel_j, e.by) for e in session.entries()] == [
        ("pending", (31.0, 41.0), "bob")
    ]
    assert not session.undo()  # where it is now only the server can tell
    session.on_receipts(receipts(session, 1))
    session.on_correspondences(moved_set((31.0, 41.0), 4))
    assert session.entries()[0].status == "accepted"
    assert session.undo()
    [back] = session.open_updates()
    assert (back.action, back.base_revision, tuple(back.pixel_j)) == ("move", 4, B)


def test_a_move_that_another_operator_forestalled_is_rejected_and_shown(session):
    session.select("r1", "r2")
    session.on_correspondences(moved_set(B, 3))
    session.move(("r1", "r2"), 4, 1, (31.0, 41.0))
    session.on_correspondences(moved_set((99.0, 99.0), 4))
    session.on_receipts(receipts(session, 1, 1))
    first, rejected = session.entries()
    assert (first.status, first.pick.pixel_j) == ("accepted", (99.0, 99.0))
    assert (rejected.status, rejected.pick.pixel_j) == ("rejected", (31.0, 41.0))


def test_held_still_pictures_go_on_when_the_operator_cancels(session):
    session.select("r1", "r2")
    show(session, "r1"), show(session, "r2")
    session.hold_still()
    assert session.frozen_views() == (view("r1"), view("r2"))
    assert session.cancel() and not session.frozen


def test_a_view_that_cannot_be_had_is_told(session):
    session.select("r1", "r2")
    session.hold(view("r1", 3), view("r2", 3))
    assert session.fetching
    session.on_not_fetched(view("r1", 3), "nobody has it")
    assert not session.fetching and "nobody has it" in session.events[-1]
