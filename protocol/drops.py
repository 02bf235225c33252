"""What arrived and could not be used, counted by reason; each reason is logged once per key.

Every process counts this way: bad input is dropped, told once, and visible as a number.
"""

import logging
import re
import threading
from collections import Counter

from fleetpose.protocol.text import one_line

log = logging.getLogger(__name__)
MAX_REASONS = 100  # texts may come from whoever sends: neither table may grow with them
MAX_SAID = 1000
MAX_SENTENCE = 300
OTHER = "other"
_PARTICULAR = re.compile(r"'[^']*'|\b[0-9a-f]{12}\b|\d+")


class Drops(Counter[str]):
    """A count per reason. Any thread may note; read a `snapshot` where others do."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[tuple[str, str]] = set()
        self._guard = threading.Lock()

    def note(self, key: str, error: Exception | str) -> None:
        """Counts what arrived under a key, and logs it the first time for this key and reason."""
        sentence = one_line(str(error), MAX_SENTENCE)
        reason = reason_of(sentence)
        with self._guard:
            if reason not in self and len(self) >= MAX_REASONS:
                reason = OTHER
            self[reason] += 1
            first = (key, reason) not in self._said and len(self._said) < MAX_SAID
            if first:
                self._said.add((key, reason))
            last = first and len(self._said) == MAX_SAID
        if first:
            log.warning("dropped key=%s reason=%s (told once)", one_line(key, 200), sentence)
        if last:
            log.warning("%d kinds of drops were told: more are only counted", MAX_SAID)

    def snapshot(self) -> dict[str, int]:
        """The counts now."""
        with self._guard:
            return dict(self)


def reason_of(sentence: str) -> str:
    """The kind of a drop: the beginning of its sentence without what differs from case to case."""
    return _PARTICULAR.sub("_", sentence.split(":")[0])[:60].strip() or OTHER
