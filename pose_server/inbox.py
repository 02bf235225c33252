"""What reaches the server beside clouds: decoded in the subscriber's thread, which only stores
it.
"""

from collections.abc import Callable
from dataclasses import dataclass

from protocol.codec import unpack
from protocol.errors import CodecError, NameRefusedError
from protocol.keys import Keys
from protocol.messages import OperatorUpdate, Selection
from protocol.transport import Link, Sample


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
    error: CodecError


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

    def refuse(self, sample: Sample, error: CodecError) -> bool:
        """Counts a refusal; True the first time for this key and reason, when it is worth a log
        line.
        """
        reason = str(error).split(":")[0][:60]
        self.drops[reason] = self.drops.get(reason, 0) + 1
        first = (sample.key, reason) not in self._said
        self._said.add((sample.key, reason))
        return first

    def _update(self, sample: Sample) -> None:
        try:
            update = unpack(OperatorUpdate, sample.payload, sample.encoding)
            self._check_operator(sample, update.operator)
        except CodecError as error:
            self._store(Refused(sample, error))
            return
        self._store(Updated(update))

    def _selection(self, sample: Sample) -> None:
        try:
            selection = unpack(Selection, sample.payload, sample.encoding)
            self._check_operator(sample, selection.operator)
        except CodecError as error:
            self._store(Refused(sample, error))
            return
        self._store(Selected(selection))

    def _check_operator(self, sample: Sample, operator: str) -> None:
        if self._keys.chunks(sample.key)[1] != operator:
            raise CodecError(f"message of '{operator}' under another operator's key")

    def _token(self, key: str, alive: bool) -> None:
        try:
            _, robot, _, epoch = self._keys.chunks(key)
        except (NameRefusedError, ValueError):
            return
        self._store(TokenSeen(robot, epoch, alive))
