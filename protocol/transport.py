"""Publishers, subscribers and queries per kind of stream. Beside `protocol.session`, which opens
sessions, the only file of the project's processes that touches zenoh.

Three facts shape it. A slow subscriber grows a queue unless it keeps the newest sample per key
only. Nothing heavy may happen in a callback. Puts can be lost silently, so latched and repeated
streams carry their own numbers.
"""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import zenoh
from zenoh import ext

from fleetpose.protocol.errors import FleetPoseError, UnreachableError
from fleetpose.protocol.session.opening import SessionSettings as SessionSettings
from fleetpose.protocol.session.opening import open_session as open_session
from fleetpose.protocol.slots import Sample, Slots
from fleetpose.protocol.text import one_line

ENCODING_JPEG = "image/jpeg"
MAX_REASON_BYTES = 500  # of an error reply
MAX_QUERIES = 256  # that wait for a queryable; more are told to ask again


def free_port() -> int:
    """A free TCP port on the loopback interface."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass
class Publisher:
    """A declared publisher; `put` takes bytes and an encoding."""

    _inner: Any

    def put(self, payload: bytes, encoding: str, attachment: bytes | None = None) -> None:
        self._inner.put(payload, encoding=zenoh.Encoding(encoding), attachment=attachment)

    def close(self) -> None:
        """Undeclares it; what it had latched is gone."""
        self._inner.undeclare()

    @property
    def wanted(self) -> bool:
        """Whether anybody subscribes at present."""
        return bool(self._inner.matching_status.matching)


@dataclass
class Link:
    """A session with the project's streams; close it in a `finally`, else the process may not
    end.
    """

    session: zenoh.Session
    _declared: list[Any] = field(default_factory=list)

    @property
    def connected(self) -> bool:
        """Whether a router, or any other process, is reached now."""
        info = self.session.info
        return bool(list(info.routers_zid()) or list(info.peers_zid()))

    def bulk(self, key: str, background: bool = False) -> Publisher:
        """For clouds and images: reliable, waits for the link, never in the way of poses. Use from
        one own thread.
        """
        return Publisher(
            self.session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.BLOCK_FIRST,
                priority=zenoh.Priority.BACKGROUND if background else zenoh.Priority.DATA_LOW,
                reliability=zenoh.Reliability.RELIABLE,
            )
        )

    def latched(self, key: str, block: bool = False, history: int = 1) -> Publisher:
        """For poses, state and updates: a late subscriber gets the last ones, a lost one is sent
        again.

        With `block` false a reader that is too slow loses samples instead of holding up the others.
        """
        return Publisher(
            ext.declare_advanced_publisher(
                self.session,
                key,
                cache=ext.CacheConfig(max_samples=history),
                sample_miss_detection=ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=0.5
                ),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.BLOCK
                if block
                else zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
                express=True,
            )
        )

    def on_bulk(self, key_expr: str, wake: Callable[[], None] | None = None) -> Slots[Sample]:
        """Subscribes to clouds or images, keeping the newest per key; `wake` is called after each,
        and must be quick.
        """
        slots: Slots[Sample] = Slots(wake)
        self._declared.append(
            self.session.declare_subscriber(key_expr, lambda sample: slots.store(_detached(sample)))
        )
        return slots

    def on_latched(self, key_expr: str, callback: Callable[[Sample], None]) -> None:
        """Subscribes with history and recovery; the callback must only store."""
        self._declared.append(self.subscribe_latched(key_expr, callback))

    def subscribe_latched(self, key_expr: str, store: Callable[[Sample], None]) -> Any:
        """Subscribes to one more key with history and recovery; undeclare what is returned to end
        it. The callback must only store.
        """
        return ext.declare_advanced_subscriber(
            self.session,
            key_expr,
            lambda sample: store(_detached(sample)),
            history=ext.HistoryConfig(detect_late_publishers=True),
            recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
        )

    def subscribe_bulk(self, key: str, store: Callable[[Sample], None]) -> Any:
        """Subscribes to one more key; undeclare what is returned to end it. The callback must only
        store.
        """
        return self.session.declare_subscriber(key, lambda sample: store(_detached(sample)))

    def token(self, key: str) -> Any:
        """Shows this process as alive under a key until the session ends, or until what is returned
        is undeclared.
        """
        token = self.session.liveliness().declare_token(key)
        self._declared.append(token)
        return token

    def on_alive(self, key_expr: str, callback: Callable[[str, bool], None]) -> None:
        """Calls back with (key, alive) for tokens that are there, come and go; the callback must
        only store.
        """
        self._declared.append(
            self.session.liveliness().declare_subscriber(
                key_expr,
                lambda sample: callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT),
                history=True,
            )
        )

    def alive(self, key_expr: str, timeout_s: float = 2.0) -> list[str]:
        """Keys of the tokens that are there now."""
        replies = self.session.liveliness().get(key_expr, timeout=timeout_s)
        return sorted(str(reply.ok.key_expr) for reply in replies if reply.ok is not None)

    def queryable(self, key: str, answer: Callable[[dict[str, str]], "Answer"]) -> None:
        """Answers queries `key?a=b;c=d` one after the other in a thread of their own."""
        queries = _Queries(key, answer)
        self._declared.append(self.session.declare_queryable(key, queries.store))
        self._declared.append(queries)
        queries.start()

    def query(self, selector: str, timeout_s: float = 3.0, background: bool = False) -> Sample:
        """Asks for one answer; with `background` the answer is never in the way of anything else.

        Raises:
            UnreachableError: nobody answered, or the answer was an error, whose text it carries.
        """
        reason = "nobody answered (not there, or not allowed)"
        priority = zenoh.Priority.BACKGROUND if background else None
        for reply in self.session.get(selector, timeout=timeout_s, priority=priority):
            if reply.ok is not None:
                return _detached(reply.ok)
            if reply.err is not None:
                text = reply.err.payload.to_bytes()[:MAX_REASON_BYTES].decode(errors="replace")
                reason = one_line(text)
        raise UnreachableError(f"{selector}: {reason}")

    def close(self) -> None:
        for declared in self._declared:
            if isinstance(declared, _Queries):
                declared.close()
        with suppress(zenoh.ZError):
            self.session.close()


@dataclass(frozen=True)
class Answer:
    """What a queryable replies: a payload, or the reason why not."""

    payload: bytes = b""
    encoding: str = ""
    attachment: bytes | None = None
    error: str | None = None


def parameters_of(text: str) -> dict[str, str]:
    """The parameters of a selector, `a=b;c=d`."""
    pairs = (part.partition("=") for part in text.split(";") if part)
    return {name: value for name, _, value in pairs}


class _Queries(threading.Thread):
    def __init__(self, key: str, answer: Callable[[dict[str, str]], Answer]) -> None:
        super().__init__(name=f"queries {key}", daemon=True)
        self._key = key
        self._answer = answer
        self._changed = threading.Condition()
        self._waiting: list[zenoh.Query] | None = []

    def store(self, query: zenoh.Query) -> None:
        with self._changed:
            if self._waiting is None:
                return
            if len(self._waiting) < MAX_QUERIES:
                self._waiting.append(query)
                self._changed.notify()
                return
        with suppress(zenoh.ZError):
            query.reply_err(b"too many ask at once: ask again", encoding=zenoh.Encoding.TEXT_PLAIN)
        query.drop()

    def close(self) -> None:
        with self._changed:
            self._waiting = None
            self._changed.notify()

    def run(self) -> None:
        for query in self._next():
            try:
                answer = self._answered(parameters_of(str(query.parameters)))
                if answer.error is not None:
                    query.reply_err(answer.error.encode(), encoding=zenoh.Encoding.TEXT_PLAIN)
                else:
                    query.reply(
                        self._key,
                        answer.payload,
                        encoding=zenoh.Encoding(answer.encoding),
                        attachment=answer.attachment,
                    )
            except zenoh.ZError:  # the session ended, or who asked has left
                continue
            finally:
                query.drop()

    def _answered(self, parameters: dict[str, str]) -> Answer:
        try:
            return self._answer(parameters)
        except FleetPoseError as error:
            return Answer(error=str(error))

    def _next(self) -> Iterator[zenoh.Query]:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting is None or self._waiting)
                if self._waiting is None:
                    return
                query = self._waiting.pop(0)
            yield query


def _detached(sample: zenoh.Sample) -> Sample:
    return Sample(
        str(sample.key_expr),
        sample.payload.to_bytes(),
        str(sample.encoding),
        None if sample.attachment is None else sample.attachment.to_bytes(),
        time.monotonic(),
    )


def wait_until(condition: Callable[[], bool], timeout_s: float, poll_s: float = 0.02) -> bool:
    """Polls a condition; whether it came true in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(poll_s)
    return True
