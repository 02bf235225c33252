"""What reaches the server beside clouds: decoded in the subscriber's thread, which only stores
it.
"""

import re
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from queue import SimpleQueue
from typing import TypeVar

from fleetpose.pose_server.state.site import MAX_EPOCHS
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import (
    CameraAnnouncement,
    Denials,
    Odometry,
    OperatorUpdate,
    Selection,
)
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.messages.fields import EPOCH_PATTERN
from fleetpose.protocol.transport import Answer, Link, Sample

M = TypeVar("M", bound=Message)
MAX_WAITING = 10_000  # an operator's client repeats what it sent; a token that is lost is rare
MAX_TOKENS = MAX_EPOCHS
MAX_NAMES = 2000
_EPOCH = re.compile(EPOCH_PATTERN)


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
class Moved:
    """A robot said where it is in its own odometry frame."""

    odometry: Odometry


@dataclass(frozen=True)
class Announced:
    """A robot said what its camera is."""

    announcement: CameraAnnouncement


@dataclass(frozen=True)
class Denied:
    """A router said what its rules deny."""

    denials: Denials


@dataclass(frozen=True)
class TokenSeen:
    """A robot's token came or went."""

    robot: str
    epoch: str
    alive: bool


@dataclass(frozen=True)
class ServerEvent:
    """Something that operators should know, from another thread of the server."""

    text: str


@dataclass(frozen=True)
class Asked:
    """A query that the server's own thread answers, when it comes to it."""

    reply: Callable[[], Answer]
    answer: "Future[Answer]"


class EventQueue:
    """Subscribes, decodes small messages and stores them.

    Args:
        keys: of the site.
        store: where they wait for the server's own thread.
        drops: where what cannot be used is counted.
    """

    def __init__(self, keys: Keys, store: "SimpleQueue[object]", drops: Drops) -> None:
        self._keys, self._store, self._drops = keys, store, drops
        self._tokens: dict[str, set[str]] = {}  # by robot; written in the callback of tokens alone

    def subscribe(self, link: Link) -> None:
        """Declares all subscriptions but that of the clouds."""
        link.on_latched(self._keys.updates("*"), self._update)
        link.on_latched(self._keys.selection("*"), self._selection)
        link.on_latched(self._keys.odometry("*"), self._odometry)
        link.on_latched(self._keys.camera("*"), self._camera)
        link.on_latched(self._keys.denials("*"), self._denials)
        link.on_alive(self._keys.robot_alive("*", "*"), self._token)

    def wake(self) -> None:
        """Wakes the server's thread unless it has something to do anyway."""
        if self._store.empty():
            self._store.put(Wake())

    def _update(self, sample: Sample) -> None:
        self._read(sample, OperatorUpdate, Updated)

    def _selection(self, sample: Sample) -> None:
        self._read(sample, Selection, Selected)

    def _odometry(self, sample: Sample) -> None:
        self._read(sample, Odometry, Moved, owner="robot")

    def _camera(self, sample: Sample) -> None:
        self._read(sample, CameraAnnouncement, Announced, owner="robot")

    def _denials(self, sample: Sample) -> None:
        self._read(sample, Denials, Denied, owner="router")

    def _read(
        self,
        sample: Sample,
        kind: type[M],
        event: Callable[[M], object],
        owner: str = "operator",
    ) -> None:
        """Stores what a message is, or counts why it is none. Its owner has the key to himself."""
        try:
            message = unpack(kind, sample.payload, sample.encoding)
            if self._keys.chunks(sample.key)[1] != getattr(message, owner, None):
                raise CodecError(f"message under another {owner}'s key")
            if self._store.qsize() >= MAX_WAITING:
                raise CodecError("more messages than the server can read")
        except FleetPoseError as error:
            self._drops.note(sample.key, error)
            return
        self._store.put(event(message))

    def _token(self, key: str, alive: bool) -> None:
        try:
            _, robot, _, epoch = self._keys.chunks(key)
            if not _EPOCH.fullmatch(epoch):
                raise CodecError(f"token with the epoch '{epoch}'")
            if not (self._comes(robot, epoch) if alive else self._goes(robot, epoch)):
                return
        except FleetPoseError as error:
            if alive:  # once for its coming and going
                self._drops.note(key, error)
            return
        self._store.put(TokenSeen(robot, epoch, alive))

    def _comes(self, robot: str, epoch: str) -> bool:
        """Whether a token is taken: who shows thousands must not keep the server's thread busy.

        Raises:
            CodecError: there is no room for it.
        """
        there = self._tokens.get(robot, set())
        if epoch not in there and len(there) >= MAX_TOKENS:
            raise CodecError(f"too many tokens under one name: {MAX_TOKENS} of '{robot}'")
        if robot not in self._tokens and len(self._tokens) >= MAX_NAMES:
            raise CodecError(f"tokens under more than {MAX_NAMES} names")
        self._tokens.setdefault(robot, set()).add(epoch)
        return True

    def _goes(self, robot: str, epoch: str) -> bool:
        """Whether a token that goes was taken when it came."""
        there = self._tokens.get(robot, set())
        if epoch not in there:
            return False
        there.remove(epoch)
        if not there:
            del self._tokens[robot]
        return True
