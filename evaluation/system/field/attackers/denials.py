"""What routers say they denied, and whom they did not let in."""

import re
import threading
from collections import Counter

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Denials
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link

WORDS = {
    "put": "Put",
    "delete": "Delete",
    "listen": "Subscriber",
    "ask": "Query",
    "answer": "Queryable",
    "show": "Liveliness Token",
    "see": "Liveliness (Query|Subscriber)",
}
"""What somebody does, and how the router's line of it ends before the direction."""


class HeardDenials:
    """The newest word of each router, from `router/*/denials`.

    Args:
        link: of somebody who may hear it; it must outlive this.
        keys: of the site.
    """

    def __init__(self, link: Link, keys: Keys) -> None:
        self._lock = threading.Lock()
        self._said: dict[str, Denials] = {}
        link.on_latched(keys.denials("*"), self._note)

    def _note(self, sample: Sample) -> None:
        try:
            said = unpack(Denials, sample.payload, sample.encoding)
        except CodecError:
            return
        with self._lock:
            self._said[said.router] = said

    def heard(self) -> bool:
        """Whether any router has said anything."""
        with self._lock:
            return bool(self._said)

    def denied(self) -> Counter[tuple[str, str, str]]:
        """How often, by name in the certificate, kind of message, and kind of key."""
        with self._lock:
            rows = [row for said in self._said.values() for row in said.denied]
        counts: Counter[tuple[str, str, str]] = Counter()
        for row in rows:
            counts[row.who, row.what, row.key] += row.n
        return counts

    def refused(self) -> Counter[str]:
        """Handshakes that failed, by cause."""
        with self._lock:
            return sum((Counter(said.refused) for said in self._said.values()), Counter())


def names(rows: Counter[tuple[str, str, str]], who: str, verb: str, key: str) -> bool:
    """Whether a denial of this is told, by certificate and key."""
    ending = re.compile(rf"(^|[ /]){WORDS[verb]} \(ingress\)$")
    return any(
        row[0] == who and row[2] == key and ending.search(row[1]) is not None for row in rows
    )
