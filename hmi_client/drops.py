"""What a client received and could not use, counted by reason."""

import logging
import re
from collections import Counter

log = logging.getLogger(__name__)
MAX_REASONS = 50  # texts may come from whoever sends: neither table may grow with them
MAX_SAID = 1000
OTHER = "other"


class Drops(Counter[str]):
    """A count per reason; each reason is logged once per key, not each time."""

    def __init__(self) -> None:
        super().__init__()
        self._said: set[tuple[str, str]] = set()

    def note(self, key: str, sentence: str) -> None:
        """Counts what arrived under a key; what differs from case to case is left out of the
        reason.
        """
        reason = reason_of(sentence)
        if reason not in self and len(self) >= MAX_REASONS:
            reason = OTHER
        self[reason] += 1
        if (key, reason) not in self._said and len(self._said) < MAX_SAID:
            self._said.add((key, reason))
            log.warning("dropped %s: %s (told once)", key, sentence)


def reason_of(sentence: str) -> str:
    """The beginning of a sentence without its quotations and numbers."""
    return re.sub(r"'[^']*'|\d+", "_", sentence.split(":")[0])[:60]
