"""Latched publishers, one per key, declared when first needed."""

from collections import OrderedDict

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.transport import Link, Publisher

MAX_PUBLISHERS = 20_000  # two per pair of a hundred robots, and room


class Publishers:
    """Publishes messages under any key; beyond the limit the one that was silent longest goes, and
    what it had latched with it.
    """

    def __init__(self, link: Link, limit: int = MAX_PUBLISHERS) -> None:
        self._link, self._limit = link, limit
        self._open: OrderedDict[str, Publisher] = OrderedDict()

    def __len__(self) -> int:
        return len(self._open)

    def put(self, key: str, message: Message) -> None:
        """Publishes a message as the newest of its key."""
        publisher = self._open.pop(key, None) or self._link.latched(key)
        self._open[key] = publisher
        publisher.put(pack(message), encoding_of(type(message)))
        while len(self._open) > self._limit:
            self._open.popitem(last=False)[1].close()
