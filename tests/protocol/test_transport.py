"""The streams do what the processes rely on, over a real router on the loopback interface."""

import threading

import pytest

from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.transport import (
    Answer,
    Link,
    Sample,
    SessionSettings,
    Slots,
    free_port,
    open_session,
    wait_until,
)

ENCODING = "application/msgpack;fleet.test.v1"


@pytest.fixture
def links():
    """Opens links to one router: `links()`."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    opened = [Link(open_session(SessionSettings(listen=(endpoint,))))]

    def open_link() -> Link:
        opened.append(Link(open_session(SessionSettings(connect=(endpoint,), timeout_s=5))))
        return opened[-1]

    yield open_link
    for link in reversed(opened):
        link.close()


def test_a_late_subscriber_gets_the_latched_history_then_what_follows(links):
    sender, early, receiver = links(), links(), links()
    publisher = sender.latched("fleet/t/pose/r1", history=3)
    through: list[Sample] = []
    early.on_latched("fleet/t/pose/**", through.append)
    for n in range(5):
        publisher.put(b"%d" % n, ENCODING)
        assert wait_until(lambda n=n: len(through) > n, 30)  # none is left to be forwarded
    got: list[Sample] = []
    receiver.on_latched("fleet/t/pose/**", got.append)
    assert wait_until(lambda: len(got) >= 3, 30)
    publisher.put(b"5", ENCODING)
    assert wait_until(lambda: len(got) >= 4, 30)
    assert [sample.payload for sample in got] == [b"2", b"3", b"4", b"5"]
    assert {sample.key for sample in got} == {"fleet/t/pose/r1"}
    assert {sample.encoding for sample in got} == {ENCODING}


def test_bulk_keeps_the_newest_of_every_key(links):
    sender, receiver = links(), links()
    first, second = sender.bulk("fleet/t/a/cloud"), sender.bulk("fleet/t/b/cloud")
    slots = receiver.on_bulk("fleet/t/*/cloud")
    assert wait_until(lambda: first.wanted and second.wanted, 30)
    for n in range(10):
        first.put(b"a%d" % n, ENCODING, attachment=b"name")
        assert wait_until(lambda n=n: len(slots._slots) + slots.replaced == n + 1, 30)
    second.put(b"b0", ENCODING)
    assert wait_until(lambda: len(slots._slots) == 2 and slots.replaced == 9, 30)
    taken = [slots.take(30), slots.take(30)]
    assert {sample.payload for sample in taken if sample} == {b"a9", b"b0"}
    assert {sample.attachment for sample in taken if sample} == {b"name", None}
    assert slots.take(0) is None


def test_a_publisher_knows_whether_anybody_wants_its_samples(links):
    sender, receiver = links(), links()
    publisher = sender.bulk("fleet/t/a/image", background=True)
    assert not publisher.wanted
    subscriber = receiver.subscribe_bulk("fleet/t/a/image", Slots().store)
    assert wait_until(lambda: publisher.wanted, 30)
    subscriber.undeclare()
    assert wait_until(lambda: not publisher.wanted, 30)


def test_a_query_gets_its_answer_and_passes_its_parameters(links):
    asker, answerer = links(), links()
    answerer.queryable(
        "fleet/t/view", lambda given: Answer(given["seq"].encode(), ENCODING, b"more")
    )
    assert wait_until(lambda: _answers(asker, "fleet/t/view?seq=0"), 30)
    answer = asker.query("fleet/t/view?seq=12;epoch=ab")
    assert (answer.payload, answer.encoding, answer.attachment) == (b"12", ENCODING, b"more")


def test_an_error_answer_carries_its_reason(links):
    asker, answerer = links(), links()
    answerer.queryable("fleet/t/view", lambda _: Answer(error="view 3 is not kept"))
    assert wait_until(lambda: "not kept" in _failure(asker, "fleet/t/view?seq=3"), 30)


def test_a_query_that_nobody_answers_says_so(links):
    assert "nobody answered" in _failure(links(), "fleet/t/none")


def test_a_token_shows_while_its_session_lives(links):
    robot, watcher = links(), links()
    seen: list[tuple[str, bool]] = []
    watcher.on_alive("fleet/t/robot/*/alive/*", lambda key, alive: seen.append((key, alive)))
    key = "fleet/t/robot/r1/alive/0a"
    robot.token(key)
    assert wait_until(lambda: (key, True) in seen, 30)
    assert wait_until(lambda: watcher.alive("fleet/t/robot/*/alive/*") == [key], 30)
    robot.close()
    assert wait_until(lambda: seen[-1] == (key, False), 30)
    assert set(seen[:-1]) == {(key, True)}  # history may tell what came meanwhile once more
    assert watcher.alive("fleet/t/robot/*/alive/*") == []


def test_no_router_is_said_with_its_endpoint():
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with pytest.raises(UnreachableError, match=endpoint):
        open_session(SessionSettings(connect=(endpoint,), timeout_s=0.3))


def test_slots_serve_the_key_that_waits_longest():
    slots = Slots()
    for key in ("a", "b", "a"):
        slots.store(Sample(key, key.encode(), ENCODING))
    assert [slots.take(0).key, slots.take(0).key] == ["a", "b"]  # type: ignore[union-attr]
    assert slots.replaced == 1


def test_a_closed_slot_frees_its_reader():
    slots = Slots()
    taken: list[Sample | None] = []
    reader = threading.Thread(target=lambda: taken.append(slots.take()))
    reader.start()
    slots.close()
    reader.join(5)
    assert taken == [None]


def _answers(link: Link, selector: str) -> bool:
    return not _failure(link, selector)


def _failure(link: Link, selector: str) -> str:
    try:
        link.query(selector, timeout_s=1)
    except UnreachableError as error:
        return str(error)
    return ""
