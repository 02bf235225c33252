"""What reaches the server beside clouds: decoded in the subscriber's thread, which only stores
it.
"""

import re
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import TypeVar

from protocol.base import Message
from protocol.codec import unpack
from protocol.errors import CodecError, FleetPoseError, NameRefusedError
from protocol.fields import EPOCH_PATTERN
from protocol.keys import Keys
from protocol.messages import OperatorUpdate, Selection
from protocol.transport import Answer, Link, Sample

M = TypeVar("M", bound=Message)
MAX_REASONS = 100
MAX_SAID = 1000
_EPOCH = re.compile(EPOCH_PATTERN)
_PARTICULAR = re.compile(r"'[^']*'|[0-9]+|[0-9a-f]{12}")


@dataclass(frozen=True)
class Wake:
    """A cloud arrived."""


@dataclass(frozen=True)
class Updated:
    """An operator changed correspondences."""

    update: OperatorUpdate


@dataclass(frozen=True)
class Selected:
    """An operator looks at a pair."""

    selection: Selection


@dataclass(frozen=True)
class TokenSeen:
    """A robot's token came or went."""

    robot: str
    epoch: str
    alive: bool


@dataclass(frozen=True)
class Refused:
    """Something that could not be read."""

    sample: Sample
    error: FleetPoseError


@dataclass(frozen=True)
class Asked:
    """A query that the server's own thread answers."""

    parameters: dict[str, str]
    answer: "Future[Answer]"


class Inbox:
    """Subscribes, decodes small messages and stores them; counts what it refuses."""

    def __init__(self, keys: Keys, store: Callable[[object], None]) -> None:
        self._keys = keys
        self._store = store
        self.drops: dict[str, int] = {}
        self._said: set[tuple[str, str]] = set()

    def subscribe(self, link: Link) -> None:
        """Declares all subscriptions but that of the clouds."""
        link.on_latched(self._keys.updates("*"), self._update)
        link.on_latched(self._keys.selection("*"), self._selection)
        link.on_alive(self._keys.robot_alive("*", "*"), self._token)

    def refuse(self, sample: Sample, error: FleetPoseError) -> bool:
        """Counts a refusal; True the first time for this key and reason, when it is worth a log
        line.
        """
        reason = reason_of(error)
        if reason not in self.drops and len(self.drops) >= MAX_REASONS:
            reason = "other"
        self.drops[reason] = self.drops.get(reason, 0) + 1
        first = (sample.key, reason) not in self._said and len(self._said) < MAX_SAID
        if first:
            self._said.add((sample.key, reason))
        return first

    def _update(self, sample: Sample) -> None:
        self._read(sample, OperatorUpdate, Updated)

    def _selection(self, sample: Sample) -> None:
        self._read(sample, Selection, Selected)

    def _read(self, sample: Sample, kind: type[M], event: Callable[[M], object]) -> None:
        """Stores what a message of an operator is, or why it is none."""
        try:
            message = unpack(kind, sample.payload, sample.encoding)
            if self._keys.chunks(sample.key)[1] != getattr(message, "operator", None):
                raise CodecError("message under another operator's key")
        except (CodecError, NameRefusedError) as error:
            self._store(Refused(sample, error))
            return
        self._store(event(message))

    def _token(self, key: str, alive: bool) -> None:
        try:
            _, robot, _, epoch = self._keys.chunks(key)
            if not _EPOCH.fullmatch(epoch):
                raise CodecError(f"token with the epoch '{epoch}'")
        except (NameRefusedError, CodecError) as error:
            self._store(Refused(Sample(key, b"", ""), error))
            return
        self._store(TokenSeen(robot, epoch, alive))


def reason_of(error: FleetPoseError) -> str:
    """The kind of an error: its sentence without what differs from message to message."""
    return _PARTICULAR.sub("#", str(error).split(":")[0])[:80]
