"""One process per name: a second one is refused while the first lives, and a first one that was
taken over learns of it. And which server of a site lives: nobody else speaks for it.
"""

import re
import threading
import time

from fleetpose.protocol.errors import CodecError, NameTakenError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages.fields import EPOCH_PATTERN
from fleetpose.protocol.transport import Link, wait_until

LEASE_S = 2.0
"""So long a process that died without a word still seems alive."""

_ASK_S = 0.5  # that the network has to tell which servers live

_EPOCH = re.compile(EPOCH_PATTERN)


class Presence:
    """A claimed name, from now to the end of the session.

    Args:
        link: the session.
        everybody: key expression of all tokens under the name.
        mine: key of this process's token.
        who: what is claimed, for the sentence that refuses.
        remedy: what a user can do about it.
        takeover: claim the name even while another process has it.

    Raises:
        NameTakenError: another process was alive under the name, and still is after one lease.
    """

    def __init__(
        self, link: Link, everybody: str, mine: str, who: str, remedy: str, takeover: bool = False
    ) -> None:
        self._mine, self._who = mine, who
        self._before: set[str] = set()
        self._successor: str | None = None
        if not takeover and not wait_until(lambda: not link.alive(everybody), LEASE_S, poll_s=0.1):
            others = ", ".join(link.alive(everybody))
            raise NameTakenError(f"{who} is already alive ({others}): {remedy}")
        self._before = set(link.alive(everybody))
        link.token(mine)
        link.on_alive(everybody, self._note)

    def check(self) -> None:
        """Raises NameTakenError if another process has taken the name over since."""
        if self._successor is not None:
            raise NameTakenError(f"{self._who} was taken over by {self._successor}")

    def _note(self, key: str, alive: bool) -> None:
        known = key == self._mine or key in self._before
        if alive and not known and _EPOCH.fullmatch(key.rsplit("/", 1)[-1]):
            self._successor = key


class LiveServer:
    """The server of a site that lives now, by its token.

    A message may overtake the token of its server, so an epoch that is not known is asked for,
    once in a lease: who floods with others must not make everybody ask all the time.

    Args:
        link: the session; the tokens are watched from now on.
        keys: of the site.
    """

    def __init__(self, link: Link, keys: Keys) -> None:
        self._link, self._everybody = link, keys.server_alive("*")
        self._guard, self._asking = threading.Lock(), threading.Lock()
        self._epochs: tuple[str, ...] = ()  # that live; the last one counts
        self._gone_s = time.monotonic()
        self._told: tuple[str, ...] = ()  # that lived when the network was asked last
        self._asked_s = -LEASE_S
        link.on_alive(self._everybody, self._note)

    @property
    def epoch(self) -> str | None:
        """Of the server that lives, None without one."""
        epochs = self._epochs
        return epochs[-1] if epochs else None

    @property
    def absent_s(self) -> float:
        """For how long there has been no server; 0 while there is one."""
        return 0.0 if self._epochs else time.monotonic() - self._gone_s

    def check(self, epoch: str, what: str) -> None:
        """Refuses what another process says.

        Args:
            epoch: that a message names.
            what: it is, e.g. `a pose`.

        Raises:
            CodecError: it is not that of the server that lives.
        """
        if epoch == self.epoch:
            return
        told = epoch in self._asked()
        lives = self.epoch
        if epoch == lives or (told and epoch not in self._epochs):  # its token came, or will
            return
        raise CodecError(f"{what} of server {epoch} that is not alive: alive is {lives or 'none'}")

    def _asked(self) -> tuple[str, ...]:
        """The epochs of the servers that live, as the network says."""
        with self._asking:
            if time.monotonic() > self._asked_s + LEASE_S:
                alive = self._link.alive(self._everybody, _ASK_S)
                self._told = tuple(key.rsplit("/", 1)[-1] for key in alive)
                self._asked_s = time.monotonic()
            return self._told

    def _note(self, key: str, alive: bool) -> None:
        epoch = key.rsplit("/", 1)[-1]
        if not _EPOCH.fullmatch(epoch):
            return
        with self._guard:
            others = tuple(known for known in self._epochs if known != epoch)
            self._epochs = (*others, epoch) if alive else others
            if not self._epochs:
                self._gone_s = time.monotonic()
