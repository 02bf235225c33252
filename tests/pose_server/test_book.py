"""The book of correspondences: order, exactly once, reasons."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.correspondences.records import JournalError
from fleetpose.pose_server.correspondences.store import MAX_AHEAD, MAX_PER_PAIR, CorrespondenceStore
from tests.pose_server.correspondence_makers import (
    EPOCH,
    OTHER_SESSION,
    SESSION,
    DepthHistory,
    add,
    apply,
    content,
    keeps,
    lift,
    update,
    view,
)


def reason_of(book, one):
    (outcome,) = apply(book, one)
    assert not outcome.accepted
    assert book.receipts(one, EPOCH).rejections[-1].reason == outcome.reason
    return outcome.reason


def test_accepted_click_is_lifted_when_it_arrives_and_published():
    book = CorrespondenceStore(DepthHistory())
    (outcome,) = apply(book, add(1, 120.0))
    assert outcome.accepted and outcome.pair == ("r1", "r2")
    (kept,) = book.of("r2", "r1")
    assert np.allclose(kept.p_i, lift(view("r1"), np.array([120.0, 50.0])).p)
    assert np.allclose(kept.C_j, lift(view("r2"), np.array([140.0, 60.0])).C)
    message = book.message("r1", "r2", EPOCH)
    assert message.revision == 1 and message.items[0].status == "unused"
    assert book.views() == {view("r1"), view("r2")}
    assert book.receipts(add(1), EPOCH).n == 1


def test_repeated_update_changes_nothing():
    book, recorder = CorrespondenceStore(memory := DepthHistory()), memory
    apply(book, add(1))
    before = content(book)
    assert apply(book, add(1), add(1, 300.0)) == []
    assert content(book) == before and len(recorder.changes) == 1


def test_early_update_waits_for_the_gap_to_close():
    book = CorrespondenceStore(DepthHistory())
    assert apply(book, add(3, 300.0), add(2, 200.0)) == []
    assert book.receipts(add(1), EPOCH).n == 0 and book.all() == []
    outcomes = apply(book, add(1, 100.0))
    assert [outcome.n for outcome in outcomes] == [1, 2, 3]
    assert [kept.item.pixel_i[0] for kept in book.all()] == [100.0, 200.0, 300.0]


def test_update_far_ahead_is_not_stored():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(MAX_AHEAD), add(MAX_AHEAD + 1))
    assert apply(book, add(1))[-1].n == 1
    assert apply(book, add(2, 200.0))[-1].n == 2
    waiting = book._waiting["ann", SESSION]
    assert set(waiting) == {MAX_AHEAD}


def test_endless_sessions_do_not_fill_the_memory():
    book = CorrespondenceStore(DepthHistory())
    for k in range(500):
        apply(book, add(2, session=f"{k:012x}"))
    assert len(book._waiting) <= 64


def test_sessions_do_not_wait_for_each_other():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(2, 300.0))
    (outcome,) = apply(book, add(1, 200.0, session=OTHER_SESSION))
    assert outcome.accepted


@pytest.mark.parametrize(
    ("one", "reason"),
    [
        (add(1, i="r2", j="r1"), "must be two, in order"),
        (add(1, i="r1", j="r1"), "must be two, in order"),
        (add(1, view_i=view("r3")), "not of the robots r1 and r2"),
        (add(1, view_j=view("r2", 100)), "is not kept any more: pick in a newer image"),
        (add(1, 590.0), "r2: no depth here, nearest usable point is 12 px away"),
        (update("move", 1, correspondence=0), "correspondence 0 of r1, r2 is not there"),
        (update("erase", 1, correspondence=7), "correspondence 7 of r1, r2 is not there"),
        (update("clear", 1, base_revision=3), "is at revision 0, this was made at 3"),
    ],
)
def test_impossible_update_is_finally_rejected_with_its_reason(one, reason):
    book = CorrespondenceStore(DepthHistory())
    assert reason in reason_of(book, one)
    assert book.all() == [] and book.receipts(one, EPOCH).n == 1
    assert apply(book, one) == []


def test_duplicate_within_a_pixel_is_rejected_and_a_neighbour_is_not():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(1, 100.0))
    assert "duplicate of correspondence 0" in reason_of(book, add(2, 100.6))
    assert apply(book, add(3, 102.0))[0].accepted
    assert "duplicate" in reason_of(
        book, update("move", 4, 101.8, correspondence=0, base_revision=0)
    )
    assert apply(book, add(5, 100.0, view_i=view("r1", 2)))[0].accepted


def test_move_keeps_the_id_and_counts_the_revision_up():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(1))
    assert apply(book, update("move", 2, 150.0, correspondence=0))[0].accepted
    (kept,) = book.all()
    assert (kept.item.id, kept.item.revision, kept.item.pixel_i[0]) == (0, 1, 150.0)
    assert kept.p_i[0] == 1.5
    assert book.message("r1", "r2", EPOCH).revision == 2


@pytest.mark.parametrize("action", ["move", "erase"])
def test_change_made_against_an_older_revision_is_rejected(action):
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(1), update("move", 2, 150.0, correspondence=0))
    late = update(action, 1, 200.0, correspondence=0, base_revision=0, session=OTHER_SESSION)
    reason = reason_of(book, late)
    assert "is at revision 1, this was made at 0" in reason
    assert book.all()[0].item.pixel_i[0] == 150.0


def test_clear_against_an_older_set_is_rejected_and_else_erases_all():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(1), add(2, 200.0), add(3, 300.0, i="r1", j="r3"))
    assert "meanwhile" in reason_of(book, update("clear", 4, base_revision=1))
    assert apply(book, update("clear", 5, base_revision=2))[0].accepted
    assert book.of("r1", "r2") == [] and len(book.of("r1", "r3")) == 1
    assert book.message("r1", "r2", EPOCH).revision == 3


def test_ids_are_never_given_twice():
    book = CorrespondenceStore(DepthHistory())
    apply(book, add(1), update("erase", 2, correspondence=0), add(3))
    assert [kept.item.id for kept in book.all()] == [1]


def test_pair_takes_only_so_many():
    book = CorrespondenceStore(DepthHistory())
    columns = np.linspace(0, 500, MAX_PER_PAIR)
    rows = [np.array([0.0, 3.0 * k]) for k in range(MAX_PER_PAIR)]
    for k, (u, pixel) in enumerate(zip(columns, rows, strict=True), 1):
        assert apply(book, add(k, u, pixel_j=pixel))[0].accepted
    assert "most a pair can have" in reason_of(book, add(MAX_PER_PAIR + 1, 3.0))


def test_failed_record_changes_nothing_and_the_repeat_succeeds():
    book = CorrespondenceStore(memory := DepthHistory())
    apply(book, add(1))
    before = content(book)
    memory.full = True
    for one in (add(2, 200.0), update("erase", 2, correspondence=0)):
        with pytest.raises(JournalError):
            apply(book, one)
        assert content(book) == before and book.receipts(one, EPOCH).n == 1
    memory.full = False
    assert [outcome.n for outcome in apply(book, add(2, 200.0))] == [2]


def test_what_was_recorded_before_a_failure_is_told_and_the_rest_waits():
    book = CorrespondenceStore(memory := DepthHistory())
    apply(book, add(2, 200.0), add(3, 300.0))
    record = memory.record

    def record_one(change):
        record(change)
        memory.full = True

    memory.record = record_one
    assert [outcome.n for outcome in apply(book, add(1))] == [1]
    with pytest.raises(JournalError):
        apply(book, add(1))  # the operator repeats what has no receipt, or anything else
    memory.full, memory.record = False, record
    assert [outcome.n for outcome in apply(book, add(1))] == [2, 3]


def test_views_that_were_clicked_in_are_recorded_with_the_click():
    book = CorrespondenceStore(memory := DepthHistory())
    book.apply(add(1), keeps, lift, lambda name: str(name).encode())
    book.apply(add(2, 590.0), keeps, lift, lambda name: str(name).encode())
    assert memory.changes[0].views == {v: str(v).encode() for v in (view("r1"), view("r2"))}
    assert memory.changes[1].rejection is not None and memory.changes[1].views == {}


def test_status_is_no_revision_and_only_news_counts():
    book = CorrespondenceStore(memory := DepthHistory())
    apply(book, add(1))
    assert book.set_status(("r1", "r2"), {0: ("accepted", 0.1, 2.0), 99: ("outlier", 1.0, 1.0)})
    item = book.all()[0].item
    assert (item.status, item.residual_m, item.residual_px, item.revision) == (
        "accepted",
        0.1,
        2.0,
        0,
    )
    assert not book.set_status(("r1", "r2"), {0: ("accepted", 0.1005, 2.01)})
    assert book.set_status(("r1", "r2"), {0: ("outlier", 0.1, 2.0)})
    assert book.set_status(("r1", "r2"), {0: ("unused", None, None)})
    assert not book.set_status(("r5", "r6"), {0: ("accepted", 0.1, 1.0)})
    assert book.message("r1", "r2", EPOCH).revision == 1 and len(memory.changes) == 1


def test_bug_in_a_lift_is_not_hidden():
    book = CorrespondenceStore(DepthHistory())

    def broken(name, pixel):
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        book.apply(add(1), keeps, broken)
    assert book.receipts(add(1), EPOCH).n == 0


@st.composite
def scripts(draw):
    """What one operator sends: updates of all kinds, some of them to be rejected."""
    steps = []
    for n in range(1, draw(st.integers(1, 12)) + 1):
        action = draw(st.sampled_from(["add", "add", "add", "move", "erase", "clear"]))
        more = {"base_revision": draw(st.integers(0, 3))}
        if action in ("move", "erase"):
            more["correspondence"] = draw(st.integers(0, 4))
        pair = draw(st.sampled_from([("r1", "r2"), ("r1", "r3")]))
        steps.append(update(action, n, float(draw(st.integers(0, 12)) * 50), *pair, **more))
    return steps


@settings(deadline=None, max_examples=60)
@given(data=st.data(), steps=scripts())
def test_any_interleaving_with_repeats_and_gaps_gives_the_book_of_the_order(data, steps):
    ordered = CorrespondenceStore(in_order := DepthHistory())
    apply(ordered, *steps)
    shuffled = data.draw(st.permutations(steps))
    repeats = data.draw(st.lists(st.sampled_from(steps), max_size=10))
    sent = data.draw(st.permutations([*shuffled, *repeats]))
    mixed = CorrespondenceStore(memory := DepthHistory())
    outcomes = apply(mixed, *sent)
    assert [outcome.n for outcome in outcomes] == list(range(1, len(steps) + 1))
    assert content(mixed) == content(ordered)
    assert mixed.receipts(steps[0], EPOCH) == ordered.receipts(steps[0], EPOCH)
    assert [c.rejection for c in memory.changes] == [c.rejection for c in in_order.changes]
