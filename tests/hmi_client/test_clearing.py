"""Clearing a pair while own clicks in it are on their way, against the server's own store."""

import pytest
from hmi_fakes import EPOCH, fleet, view
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.hmi_client.assist.deferred_clear import SET_S
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from tests.pose_server.correspondence_makers import DepthHistory, lift

PAIR = ("r1", "r2")


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


class Site:
    """A store and its operators, with updates, receipts and sets that go and come when told."""

    def __init__(self, *operators: str) -> None:
        self.clock = Clock()
        self.correspondences = CorrespondenceStore(DepthHistory())
        self.sessions = [OperatorSession(name, clock=self.clock) for name in operators]
        for session in self.sessions:
            session.on_fleet(fleet(6))

    def send(self, session, count=100):
        """The server takes the first updates that are offered."""
        for update in session.open_updates()[:count]:
            self.correspondences.apply(update, lambda _: True, lift)

    def receipt(self, session):
        updates = session.open_updates()
        if updates:
            session.on_receipts(self.correspondences.receipts(updates[0], EPOCH))

    def tell(self, session):
        session.on_correspondences(self.correspondences.message(*PAIR, EPOCH))

    def settle(self, session):
        for _ in range(50):
            if not session.unconfirmed:
                break
            self.send(session), self.receipt(session), self.tell(session)
        assert session.unconfirmed == 0


def add(session, k):
    """The k-th click, far from all others."""
    return session.add(view("r1"), (10.0 * k, 20.0), view("r2"), (10.0 * k, 40.0))


@pytest.fixture
def site():
    return Site("anna", "berta")


def test_a_clear_waits_until_own_clicks_are_in_the_set(site):
    anna, _ = site.sessions
    clicks = [add(anna, k) for k in range(3)]
    clear = anna.clear(PAIR)
    assert [u.action for u in anna.open_updates()] == ["add"] * 3
    assert [e.status for e in anna.entries(PAIR)] == ["erasing"] * 3
    site.send(anna), site.receipt(anna)
    assert all(c.accepted for c in clicks) and anna.open_updates() == ()
    assert anna.unconfirmed == 1
    site.tell(anna)
    [update] = anna.open_updates()
    assert (update.action, update.n, update.base_revision) == ("clear", 4, 3)
    site.settle(anna)
    assert clear.accepted and site.correspondences.of(*PAIR) == []
    assert anna.entries(PAIR) == []


def test_what_follows_a_clear_stays_behind_it(site):
    anna, _ = site.sessions
    add(anna, 1)
    anna.clear(PAIR)
    after = add(anna, 2)
    site.settle(anna)
    assert after.accepted
    assert [tuple(k.item.pixel_i) for k in site.correspondences.of(*PAIR)] == [(20.0, 20.0)]
    assert [e.status for e in anna.entries(PAIR)] == ["unused"]


def test_a_click_of_another_that_was_not_seen_is_not_cleared(site):
    anna, berta = site.sessions
    add(anna, 1)
    clear = anna.clear(PAIR)
    add(berta, 2), site.settle(berta)
    site.settle(anna)
    assert "changed meanwhile" in clear.reason
    assert len(site.correspondences.of(*PAIR)) == 2
    assert {e.status for e in anna.entries(PAIR)} == {"unused"}


def test_a_click_that_another_erased_does_not_hold_a_clear_for_ever(site):
    anna, berta = site.sessions
    add(anna, 1), add(anna, 2)
    clear = anna.clear(PAIR)
    site.send(anna), site.receipt(anna)
    site.tell(berta)
    berta.erase(PAIR, berta.entries(PAIR)[0].id), site.settle(berta)
    site.tell(anna)
    assert anna.open_updates() == ()
    site.clock.now += SET_S + 0.1
    site.settle(anna)
    assert clear.accepted and site.correspondences.of(*PAIR) == []


def test_a_rejected_click_does_not_hold_a_clear(site):
    anna, _ = site.sessions
    bad = anna.add(view("r1"), (630.0, 2.0), view("r2"), (3.0, 4.0))
    add(anna, 1)
    clear = anna.clear(PAIR)
    site.settle(anna)
    assert bad.reason is not None and clear.accepted


def test_a_held_clear_can_be_undone(site):
    anna, _ = site.sessions
    add(anna, 1), add(anna, 2)
    anna.clear(PAIR)
    assert anna.undo()
    site.settle(anna), site.tell(anna)
    assert len(site.correspondences.of(*PAIR)) == 2
    assert [e.status for e in anna.entries(PAIR)] == ["unused"] * 2


def test_a_lost_journal_leaves_a_held_clear_behind_the_clicks_that_are_sent_anew(site):
    anna, _ = site.sessions
    add(anna, 1), site.settle(anna)
    add(anna, 2)
    clear = anna.clear(PAIR)
    site.correspondences = CorrespondenceStore(DepthHistory())
    anna.on_fleet(fleet(6, server_epoch="f" * 12))
    lost = site.correspondences.receipts(anna.open_updates()[0], "f" * 12)
    anna.on_receipts(lost)
    assert [(u.n, u.action) for u in anna.open_updates()] == [(1, "add")]
    for _ in range(4):
        site.send(anna)
        if anna.open_updates():
            anna.on_receipts(site.correspondences.receipts(anna.open_updates()[0], "f" * 12))
        anna.on_correspondences(site.correspondences.message(*PAIR, "f" * 12))
    assert clear.accepted and site.correspondences.of(*PAIR) == []


def test_an_erase_is_not_sent_to_a_server_that_lost_its_journal(site):
    anna, _ = site.sessions
    add(anna, 1), site.settle(anna)
    erase = anna.erase(PAIR, anna.entries(PAIR)[0].id)
    anna.on_fleet(fleet(6, server_epoch="f" * 12))
    anna.on_receipts(CorrespondenceStore(DepthHistory()).receipts(erase.update, "f" * 12))
    assert erase.final and "has lost" in erase.reason  # its id may come to mean another
    assert anna.open_updates() == ()


DEEDS = st.sampled_from(
    ["add", "add", "add", "clear", "clear", "erase", "send", "send one", "receipt", "tell"]
)


def do(site, session, deed, k, alive):
    """One step of operator, server or network; `alive` is what the operator wants to remain."""
    if deed == "add":
        alive[k] = add(session, k)
    elif deed == "clear":
        ticket = session.clear(PAIR)
        assert (ticket is None) == (not alive)
        alive.clear()
        return ticket
    elif deed == "erase":
        named = [e for e in session.entries(PAIR) if e.id is not None and e.status == "unused"]
        if named:
            session.erase(PAIR, named[0].id)
            del alive[int(named[0].pick.pixel_i[0] / 10)]
    elif deed == "undo":
        session.undo()
    elif deed == "redo":
        session.redo()
    elif deed == "send":
        site.send(session)
    elif deed == "send one":
        site.send(session, 1)
    elif deed == "receipt":
        site.receipt(session)
    else:
        site.tell(session)
    return None


@settings(max_examples=150, deadline=None)
@given(st.lists(DEEDS, max_size=30))
def test_nothing_is_rejected_for_what_the_same_client_did_and_the_order_holds(deeds):
    site = Site("anna")
    [anna] = site.sessions
    alive = {}
    clears = [do(site, anna, deed, k, alive) for k, deed in enumerate(deeds, start=1)]
    site.settle(anna)
    assert all(clear.accepted for clear in clears if clear is not None)
    assert {int(k.item.pixel_i[0] / 10) for k in site.correspondences.of(*PAIR)} == set(alive)
    site.tell(anna)
    assert {e.status for e in anna.entries(PAIR)} <= {"unused"}


@settings(max_examples=150, deadline=None)
@given(st.lists(DEEDS | st.sampled_from(["undo", "redo"]), max_size=30))
def test_with_undo_and_redo_no_clear_is_rejected_and_all_becomes_final(deeds):
    site = Site("anna")
    [anna] = site.sessions

    class Any(dict):  # what is wanted is not followed here
        def __delitem__(self, key):
            self.pop(key, None)

    clears = []
    for k, deed in enumerate(deeds, start=1):
        if deed == "clear":
            clears.append(anna.clear(PAIR))
        else:
            do(site, anna, deed, k, Any())
    site.settle(anna), site.tell(anna), site.settle(anna), site.tell(anna)
    assert all(clear.accepted for clear in clears if clear is not None)
    assert len(anna.entries(PAIR)) == len(site.correspondences.of(*PAIR))
    assert {e.status for e in anna.entries(PAIR)} <= {"unused", "rejected"}
