"""The newest sample per key: what lies between a subscriber's callback and the thread that works.

Never more than so many keys and bytes wait, whatever is sent under whatever keys.
"""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

MAX_KEYS = 4096
MAX_BYTES = 256 * 1024 * 1024


@dataclass(frozen=True)
class Sample:
    """What a subscriber or a query receives, detached from zenoh.

    Attributes:
        at_s: monotonic second of its arrival, 0 where that is not known.
    """

    key: str
    payload: bytes
    encoding: str
    attachment: bytes | None = None
    at_s: float = field(default=0.0, compare=False)


class Keyed(Protocol):
    """What has a key."""

    @property
    def key(self) -> str:
        """Under which it arrived."""
        ...


K = TypeVar("K", bound=Keyed)


class Slots(Generic[K]):
    """The newest sample per key; a reader never sees an older one and nothing queues up.

    Attributes:
        replaced: samples overtaken by a newer one of their key before they were read.
        overflowed: samples that found no room: too many keys or bytes wait.
    """

    def __init__(
        self,
        wake: Callable[[], None] | None = None,
        max_keys: int = MAX_KEYS,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        self._changed = threading.Condition()
        self._slots: dict[str, K] = {}
        self._closed = False
        self._wake = wake
        self._max_keys, self._max_bytes = max_keys, max_bytes
        self._bytes = 0
        self.replaced = 0
        self.overflowed = 0

    def __len__(self) -> int:
        return len(self._slots)

    def store(self, sample: K) -> None:
        """Takes a sample; for a callback."""
        with self._changed:
            before = self._slots.get(sample.key)
            grown = self._bytes + _size(sample) - _size(before)
            no_room = before is None and len(self._slots) >= self._max_keys
            if no_room or grown > self._max_bytes:
                self.overflowed += 1
                return
            self.replaced += before is not None
            self._slots[sample.key] = sample
            self._bytes = grown
            self._changed.notify()
        if self._wake is not None:
            self._wake()

    def take(self, timeout_s: float | None = None) -> K | None:
        """The sample of the key that waits longest, or None after the timeout or when closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._slots or self._closed, timeout_s)
            if not self._slots:
                return None
            sample = self._slots.pop(next(iter(self._slots)))
            self._bytes -= _size(sample)
            return sample

    def close(self) -> None:
        """Frees the reader."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


def _size(sample: Any) -> int:
    return len(getattr(sample, "payload", b""))
