"""One process per name: a second one is refused while the first lives, and a first one that was
taken over learns of it.
"""

import re

from protocol.errors import NameTakenError
from protocol.fields import EPOCH_PATTERN
from protocol.transport import Link, wait_until

LEASE_S = 2.0
"""So long a process that died without a word still seems alive."""

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
