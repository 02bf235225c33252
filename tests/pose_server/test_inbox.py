"""What operators send: read, counted where it is none, and never left without an answer."""

import queue

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app.event_queue import MAX_TOKENS, EventQueue, Selected, Updated
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import OperatorUpdate, Selection
from fleetpose.protocol.transport import Sample
from tests.pose_server.scene import EPOCH, turned
from tests.pose_server.test_flows import click, named, scene_with_points_to_click, site_of

KEYS = Keys("demo")
T_TRUE = turned(15)


@pytest.fixture
def inbox():
    return EventQueue(KEYS, queue.SimpleQueue(), Drops())


def put(inbox: EventQueue, update: OperatorUpdate, operator: str = "op"):
    inbox._update(Sample(KEYS.updates(operator), pack(update), encoding_of(OperatorUpdate)))
    return None if inbox._store.empty() else inbox._store.get()


@pytest.fixture(scope="module")
def scene():
    return scene_with_points_to_click(np.random.default_rng(4), T_TRUE)


def test_a_selection_is_stored(inbox):
    chosen = Selection(operator="op", session=EPOCH, i="r1", j="r2")
    inbox._selection(Sample(KEYS.selection("op"), pack(chosen), encoding_of(Selection)))
    assert inbox._store.get() == Selected(chosen)


def test_tokens_beyond_a_few_under_one_name_never_reach_the_servers_thread(inbox):
    for k in range(20_000):
        inbox._token(KEYS.robot_alive("r2", f"{k:012x}"), True)
    inbox._token(KEYS.robot_alive("r1", "a" * 12), True)
    taken = [inbox._store.get().robot for _ in range(inbox._store.qsize())]
    assert taken == ["r2"] * MAX_TOKENS + ["r1"]
    assert inbox._drops.total() == 20_000 - MAX_TOKENS
    for k in range(20_000):
        inbox._token(KEYS.robot_alive("r2", f"{k:012x}"), False)
    assert inbox._store.qsize() == MAX_TOKENS
    inbox._token(KEYS.robot_alive("r2", "b" * 12), True)
    assert inbox._store.qsize() == MAX_TOKENS + 1


def test_nobody_speaks_in_anothers_name(inbox, scene):
    assert put(inbox, click(1, scene[1][0], T_TRUE), "somebody") is None
    assert sum(inbox._drops.values()) == 1


WRONG = {
    "no number": ({"pixel_i": np.array([np.nan, 1.0])}, "no place in an image"),
    "endless": ({"pixel_j": np.array([1.0, np.inf])}, "no place in an image"),
    "far outside": ({"pixel_i": np.array([1e300, -5.0])}, "outside the image"),
    "unknown robot": ({"j": "r9", "view_j": named(0, "r9")}, "not both known"),
    "view gone": ({"view_i": named(77, "r1")}, "not kept"),
    "itself": ({"j": "r1", "view_j": named(0, "r1")}, "must be two"),
    "wrong order": ({"i": "r2", "j": "r1"}, "in order of name"),
    "views of others": ({"view_i": named(0, "r2")}, "not of the robots"),
    "no depth": ({"pixel_i": np.array([1.0, 1.0])}, "nearest usable point is"),
    "nothing to erase": ({"action": "erase", "correspondence": 5}, "is not there"),
    "old set": ({"action": "clear", "base_revision": 7}, "was changed meanwhile"),
}


@pytest.mark.parametrize("changes, reason", WRONG.values(), ids=WRONG)
def test_whatever_is_wrong_with_a_click_its_operator_is_told(inbox, scene, changes, reason):
    views, points = scene
    site = site_of(*views)
    wrong = click(1, points[0], T_TRUE).model_copy(update=changes)
    stored = put(inbox, wrong)
    assert isinstance(stored, Updated) and not inbox._drops
    (outcome,) = pipeline.receive_update(site, stored.update)
    assert not outcome.accepted and reason in outcome.reason
    receipts = site.correspondences.receipts(wrong, EPOCH)
    assert receipts.n == 1 and reason in receipts.rejections[0].reason
    (next_one,) = pipeline.receive_update(site, click(2, points[0], T_TRUE))
    assert next_one.accepted, "it holds up nothing"


def test_the_same_place_twice_is_a_duplicate(scene):
    views, points = scene
    site = site_of(*views)
    (first,) = pipeline.receive_update(site, click(1, points[0], T_TRUE))
    (second,) = pipeline.receive_update(site, click(2, points[0], T_TRUE))
    assert first.accepted and "duplicate" in second.reason
