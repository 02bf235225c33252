"""What operators send: read, counted where it is none, and never left without an answer."""

import queue

import numpy as np
import pytest

from pose_server.correspondences.book import Book
from pose_server.inbox import Inbox, Selected, Unusable, Updated
from protocol.codec import encoding_of, pack
from protocol.drops import Drops
from protocol.keys import Keys
from protocol.messages import OperatorUpdate, Selection
from protocol.transport import Sample
from tests.pose_server.correspondence_makers import EPOCH, add, keeps, lift
from tests.pose_server.test_flows import Forgetful

KEYS = Keys("demo")
ENCODING = encoding_of(OperatorUpdate)


@pytest.fixture
def inbox():
    return Inbox(KEYS, queue.SimpleQueue(), Drops())


def put(inbox: Inbox, payload: bytes, operator: str = "op", encoding: str = ENCODING):
    inbox._update(Sample(KEYS.updates(operator), payload, encoding))
    return None if inbox._store.empty() else inbox._store.get()


def broken(number: int, **changes) -> bytes:
    """An update that says whose it is and is none."""
    good = add(number)
    fields = {**dict(good), "pixel_i": np.array([np.nan, 1.0]), **changes}
    return pack(OperatorUpdate.model_construct(**fields))


def test_a_good_update_and_a_selection_are_stored(inbox):
    found = put(inbox, pack(add(1)), add(1).operator)
    assert isinstance(found, Updated) and pack(found.update) == pack(add(1))
    chosen = Selection(operator="op", session=EPOCH, i="r1", j="r2")
    inbox._selection(Sample(KEYS.selection("op"), pack(chosen), encoding_of(Selection)))
    assert inbox._store.get() == Selected(chosen)
    assert not inbox._drops


def test_an_update_that_is_none_is_counted_and_its_operator_is_told(inbox):
    operator = add(1).operator
    found = put(inbox, broken(1), operator)
    assert isinstance(found, Unusable) and "nan or inf" in found.reason
    assert (found.number.operator, found.number.n) == (operator, 1)
    assert sum(inbox._drops.values()) == 1


@pytest.mark.parametrize("change", [{"n": 0}, {"session": "x"}, {"operator": "A B"}])
def test_where_nobody_can_be_told_it_is_only_counted(inbox, change):
    assert put(inbox, broken(1, **change), add(1).operator) is None
    assert sum(inbox._drops.values()) == 1


def test_nobody_can_refuse_in_anothers_name(inbox):
    assert put(inbox, broken(1), "somebody") is None
    assert put(inbox, broken(1), add(1).operator, "application/msgpack;fleet.pose.v1") is None
    assert put(inbox, broken(1)[:-3], add(1).operator) is None
    assert sum(inbox._drops.values()) == 3


def test_a_refusal_is_final_takes_its_turn_and_holds_up_nothing():
    book = Book(Forgetful())
    early, first, second = add(2), add(1), add(3)
    assert not book.refuse(early, "nan"), "the first is missing: it will be repeated"
    book.apply(first, keeps, lift)
    assert book.refuse(early, "nan") and not book.refuse(early, "nan")
    receipts = book.receipts(early, EPOCH)
    assert receipts.n == 2 and receipts.rejections[-1].reason == "this is no update: nan"
    (outcome,) = book.apply(second, keeps, lift)
    assert outcome.accepted or outcome.reason
    assert book.receipts(second, EPOCH).n == 3
