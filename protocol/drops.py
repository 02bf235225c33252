"""What arrived and could not be used, counted by reason; each reason is logged once for each sender
and kind of key.

Every process counts this way: bad input is dropped, told once, and visible as a number. Who sends
has room of his own in the tables, so that nobody can fill them for the others.
"""

import logging
import re
import threading
from collections import Counter
from dataclasses import dataclass, field

from fleetpose.protocol.text import one_line

log = logging.getLogger(__name__)
MAX_REASONS = 100  # texts may come from whoever sends: no table may grow with them
MAX_REASONS_OF_ONE = 20
MAX_REASONS_OF_ALL = 500
MAX_SENDERS = 500  # names may be invented where no rules forbid it: more share one room
MAX_SENTENCE = 300
OTHER = "other"
_PARTICULAR = re.compile(r"'[^']*'|\b[0-9a-f]{12}\b|\d+")
_OWNERS = ("robot", "operator")  # whose names stand in their keys


@dataclass
class _Sender:
    """What came from one sender: counts by reason, and the kinds of drops that were logged."""

    counts: Counter[str] = field(default_factory=Counter)
    told: set[tuple[str, str]] = field(default_factory=set)


class Drops(Counter[str]):
    """A count per reason. Any thread may note; read a `snapshot` where others do."""

    def __init__(self) -> None:
        super().__init__()
        self._senders: dict[str, _Sender] = {"": _Sender()}
        self._guard = threading.Lock()

    def note(self, key: str, error: Exception | str) -> None:
        """Counts what arrived under a key, and logs it the first time for the sender, the kind of
        key and the reason.
        """
        sentence = one_line(str(error), MAX_SENTENCE)
        kind, name = kind_and_sender(key)
        with self._guard:
            sender = self._sender(name)
            most = MAX_REASONS if sender is self._senders[""] else MAX_REASONS_OF_ONE
            reason = self._room_for(reason_of(sentence), sender, most)
            self[reason] += 1
            sender.counts[reason] += 1
            first = (kind, reason) not in sender.told and len(sender.told) < most
            if first:
                sender.told.add((kind, reason))
            last = first and len(sender.told) == most
        if first:
            log.warning("dropped key=%s reason=%s (told once)", one_line(key, 200), sentence)
        if last:
            log.warning(
                "%d kinds of drops of %s were told: more are only counted", most, name or kind
            )

    def of(self, sender: str) -> dict[str, int]:
        """The counts of one sender, e.g. `robot/r1`."""
        with self._guard:
            known = self._senders.get(sender)
            return {} if known is None else dict(known.counts)

    def snapshot(self) -> dict[str, int]:
        """The counts now."""
        with self._guard:
            return dict(self)

    def _sender(self, name: str) -> _Sender:
        if name not in self._senders and len(self._senders) >= MAX_SENDERS:
            name = ""
        return self._senders.setdefault(name, _Sender())

    def _room_for(self, reason: str, sender: _Sender, most: int) -> str:
        """The reason, or `other` where its sender has brought up too many, or all have."""
        known = reason in sender.counts or len(sender.counts) < most
        return reason if known and (reason in self or len(self) < MAX_REASONS_OF_ALL) else OTHER


def kind_and_sender(key: str) -> tuple[str, str]:
    """The kind of a key, without names, and whose it is: `fleet/x/robot/r1/alive/0123` is of the
    kind `robot/*/alive` and of `robot/r1`. What belongs to nobody by its key has the sender ``.
    """
    chunks = one_line(key, 200).split("/")[2:]
    if len(chunks) < 3 or chunks[0] not in _OWNERS:
        return (chunks[0] if chunks else ""), ""
    return f"{chunks[0]}/*/{chunks[2]}", f"{chunks[0]}/{chunks[1]}"


def reason_of(sentence: str) -> str:
    """The kind of a drop: the beginning of its sentence without what differs from case to case."""
    return _PARTICULAR.sub("_", sentence.split(":")[0])[:60].strip() or OTHER
