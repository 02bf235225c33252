"""The robots' topics of ROS 2 on zenoh: found by their tokens, read, and written to."""

import itertools
import logging
import queue
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.transport import Link, Publisher, Sample
from fleetpose.ros_bridge.topics import Message, Wanted
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.dialects.rmw_zenoh import NO_HASH, Endpoint

log = logging.getLogger("pose-ros")

MAX_WAITING = 1000  # messages that wait to be read: ten seconds of ten robots at 10 Hz
MAX_BYTES = 1 << 20  # of one message; a tf tree has kilobytes
_CODING = "application/cdr"
_DEPTH = 100  # samples that a subscriber of ours keeps, as tf2 has it


class ZenohTopics:
    """Topics of nodes that speak rmw_zenoh, or DDS behind its bridge to zenoh.

    Args:
        link: on which they speak.
        domain: ROS_DOMAIN_ID.
        wanted: whether a topic of a type is to be read.
        drops: where what cannot be kept or read is counted.
    """

    types = staticmethod(rmw_zenoh.types().types.__getitem__)

    def __init__(self, link: Link, domain: int, wanted: Wanted, drops: Drops) -> None:
        self._writer = Writer(link, domain)
        self._reader = Reader(link, domain, wanted, drops, self._writer.note)
        self.take, self.put = self._reader.take, self._writer.put


class Reader:
    """Subscribes to topics as they appear, and keeps what comes until it is taken.

    Args:
        link: on which ROS 2 speaks.
        domain: ROS_DOMAIN_ID.
        wanted: whether a topic of a type is to be read.
        drops: where what cannot be kept is counted.
        seen: is told of every publisher and subscriber that appears; must only store.
    """

    def __init__(
        self,
        link: Link,
        domain: int,
        wanted: Wanted,
        drops: Drops,
        seen: Callable[[Endpoint], None],
    ) -> None:
        self._link, self._wanted, self._drops, self._seen = link, wanted, drops, seen
        self._waiting: queue.Queue[tuple[Endpoint, bytes]] = queue.Queue(MAX_WAITING)
        self._appeared: queue.SimpleQueue[Endpoint] = queue.SimpleQueue()
        self._subscribed: set[str] = set()
        for tokens in rmw_zenoh.tokens(domain):
            link.on_alive(tokens, self._token)

    def take(self, timeout_s: float) -> Message | None:
        """The oldest message that waits, None if none comes in time.

        Raises:
            CodecError: it is damaged.
        """
        self._subscribe()
        try:
            endpoint, payload = self._waiting.get(timeout=timeout_s)
        except queue.Empty:
            return None
        try:
            content = rmw_zenoh.types().deserialize_cdr(payload, endpoint.type)
        except Exception as error:  # generated code on foreign bytes raises whatever it likes
            raise CodecError(f"a message of {endpoint.type} cannot be read ({error})") from error
        return Message(endpoint.topic, endpoint.type, content)

    def _token(self, token: str, alive: bool) -> None:
        endpoint = rmw_zenoh.endpoint_of(token)
        if endpoint is not None and alive:
            self._appeared.put(endpoint)

    def _subscribe(self) -> None:
        """To what has appeared: not in zenoh's thread, which must only store."""
        while not self._appeared.empty():
            endpoint = self._appeared.get()
            self._seen(endpoint)
            if endpoint.kind != "publisher" or endpoint.key in self._subscribed:
                continue
            if not self._wanted(endpoint.topic, endpoint.type):
                continue
            self._subscribed.add(endpoint.key)
            log.info("reads topic=%s type=%s", endpoint.topic, endpoint.type)
            subscribe = self._link.on_latched if endpoint.latched else self._link.subscribe_bulk
            subscribe(endpoint.key, lambda sample, of=endpoint: self._store(of, sample))

    def _store(self, endpoint: Endpoint, sample: Sample) -> None:
        try:
            if len(sample.payload) > MAX_BYTES:
                raise CodecError(f"a message of {len(sample.payload)} bytes")
            self._waiting.put_nowait((endpoint, sample.payload))
        except CodecError as error:
            self._drops.note(sample.key, error)
        except queue.Full:
            self._drops.note(sample.key, CodecError("no room: more comes than is read"))


class Writer:
    """Publishes topics as a node of rmw_zenoh would.

    Args:
        link: on which ROS 2 speaks.
        domain: ROS_DOMAIN_ID.
    """

    def __init__(self, link: Link, domain: int) -> None:
        self._link, self._domain = link, domain
        self._zid = str(link.session.zid())
        self._entities = itertools.count(1)
        self._topics: dict[str, list[_Publishing]] = {}
        self._unhashed: set[str] = set()

    def note(self, endpoint: Endpoint) -> None:
        """A node subscribes: one of Humble does not know the types' hashes."""
        if endpoint.kind == "subscriber" and endpoint.hash == NO_HASH:
            self._unhashed.add(endpoint.topic)

    def put(self, topic: str, type: str, message: Any, latched: bool = False) -> None:
        """Sends a message on a topic; `latched`: whoever comes late gets it too."""
        payload = bytes(rmw_zenoh.types().serialize_cdr(message, type))
        publishing = self._topics.setdefault(topic, [])
        if not publishing:
            publishing.append(self._publish(topic, type, rmw_zenoh.type_hash(type), latched))
        if topic in self._unhashed and len(publishing) == 1:
            publishing.append(self._publish(topic, type, NO_HASH, latched))
        for one in publishing:
            one.put(payload)

    def _publish(self, topic: str, type: str, hash: str, latched: bool) -> "_Publishing":
        key = rmw_zenoh.topic_key(self._domain, topic, type, hash)
        token = rmw_zenoh.publisher_token(
            self._domain, self._zid, next(self._entities), topic, type, hash, latched, _DEPTH
        )
        publisher = self._link.latched(key) if latched else self._link.bulk(key)
        self._link.token(token)
        return _Publishing(publisher, token)


@dataclass
class _Publishing:
    publisher: Publisher
    token: str
    sent: int = 0

    def put(self, payload: bytes) -> None:
        self.sent += 1
        carried = rmw_zenoh.attachment(self.sent, time.time_ns(), self.token)
        self.publisher.put(payload, _CODING, carried)
