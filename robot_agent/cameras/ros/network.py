"""A robot's topics on zenoh: found by their tokens, subscribed to and left again."""

import itertools
import logging
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from queue import Empty, Full, Queue
from typing import Any

from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat

from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.transport import Link, Sample
from fleetpose.rosmsg.bag import Recorded
from fleetpose.rosmsg.dialects import rmw_zenoh
from fleetpose.rosmsg.dialects.rmw_zenoh import Endpoint
from fleetpose.rosmsg.live.directory import Directory
from fleetpose.rosmsg.roles import CLOUD, IMAGES
from fleetpose.rosmsg.typestore import Kind, Types

log = logging.getLogger(__name__)

MAX_BYTES = 1 << 20  # of a message that is neither an image nor a cloud
MAX_IMAGE_BYTES = 1 << 26
_WAITING = 64  # messages of one subscription that wait to be taken
_NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")

Store = Callable[[Recorded], None]


class Arrivals:
    """Messages as they come; those that find no room are counted."""

    def __init__(self, drops: Drops) -> None:
        self._queue: Queue[Recorded] = Queue(_WAITING)
        self._drops = drops

    def store(self, message: Recorded) -> None:
        """Takes a message; for a callback."""
        try:
            self._queue.put_nowait(message)
        except Full:
            self._drops.note(message.topic, "no room: more comes than is read")

    def take(self, timeout_s: float) -> Recorded | None:
        """The oldest that waits, None if none comes in time."""
        try:
            return self._queue.get(timeout=timeout_s)
        except Empty:
            return None


class RosNetwork:
    """What a robot publishes.

    Args:
        link: on which its nodes, or a bridge of theirs, speak.
        domain: ROS_DOMAIN_ID.

    Attributes:
        drops: what could not be kept or read, counted by reason.
        taken_bytes: of all messages so far.
    """

    def __init__(self, link: Link, domain: int) -> None:
        self._link, self._domain = link, domain
        self.drops = Drops()
        self.taken_bytes = 0
        self._types = Types()
        self._directory, self._guard = Directory(), threading.Lock()
        self._entities = itertools.count(1)
        self._zid = str(link.session.zid())
        for tokens in rmw_zenoh.tokens(domain):
            link.on_alive(tokens, self._token)

    def endpoints(self) -> dict[str, Endpoint]:
        """The topics that have a publisher now, by their names."""
        with self._guard:
            return self._directory.endpoints()

    @contextmanager
    def subscribed(self, endpoints: Sequence[Endpoint]) -> Iterator[Arrivals]:
        """Subscribes to topics, and leaves them at the end: what nobody takes is not sent."""
        arrivals = Arrivals(self.drops)
        with ExitStack() as leaving:
            for endpoint in endpoints:
                leaving.callback(self.subscribe(endpoint, arrivals.store))
            yield arrivals

    def subscribe(self, endpoint: Endpoint, store: Store) -> Callable[[], None]:
        """Subscribes to a topic.

        Args:
            endpoint: one of its publishers; whatever the hash of its type is, it is heard.
            store: is called with each message, in a thread of zenoh's; must only store.

        Returns:
            What ends it.
        """
        latched = endpoint.latched or endpoint.topic.endswith("tf_static")
        how = self._link.subscribe_latched if latched else self._link.subscribe_bulk
        subscription = how(endpoint.key, lambda sample: self._store(endpoint, sample, store))

        def leave() -> None:
            with suppress(Exception):  # the session may have ended before
                subscription.undeclare()

        return leave

    def show(self, endpoints: Sequence[Endpoint]) -> Callable[[], None]:
        """Shows subscribers of topics, though there are some at moments only: drivers do not work
        for nobody. A bridge to DDS needs none.

        Returns:
            What ends it.
        """
        tokens: list[Any] = [
            self._link.token(
                rmw_zenoh.subscriber_token(self._domain, self._zid, next(self._entities), endpoint)
            )
            for endpoint in endpoints
            if endpoint.hash
        ]

        def hide() -> None:
            with suppress(Exception):
                for token in tokens:
                    token.undeclare()

        return hide

    def read(self, message: Recorded) -> Any | None:
        """The message with the fields that its type names; None if it cannot be read, which is
        counted and told.
        """
        try:
            return self._types.read(message.kind, message.raw)
        except CodecError as error:
            self.drops.note(message.topic, error)
            return None

    def close(self) -> None:
        """Leaves the robot."""
        self._link.close()

    def _token(self, token: str, alive: bool) -> None:
        try:
            with self._guard:
                self._directory.note(token, alive)
        except CodecError as error:
            self.drops.note("tokens", error)

    def _store(self, endpoint: Endpoint, sample: Sample, store: Store) -> None:
        size = len(sample.payload)
        self.taken_bytes += size
        most = MAX_IMAGE_BYTES if endpoint.type in (*IMAGES, CLOUD) else MAX_BYTES
        if size > most:
            self.drops.note(endpoint.topic, f"a message of {size} bytes, of {most} at most")
            return
        store(recorded(endpoint.topic, endpoint.type, sample.payload))


def recorded(topic: str, type: str, raw: bytes) -> Recorded:
    """A message that has come now; its type is as ROS defines it."""
    return Recorded(topic, Kind(type, _NO_DEFINITION, "cdr"), time.time_ns(), raw)
