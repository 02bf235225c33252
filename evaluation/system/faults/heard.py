"""What the server says of correspondences: one operator's receipts, and the sets of all pairs."""

import itertools
import threading
import time

from fleetpose.protocol import codec
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Correspondence, PairCorrespondences, Receipts
from fleetpose.protocol.transport import Link, Sample

Pair = tuple[str, str]
Click = tuple[str, str, float, float]
"""Robots and the pixel in the first one's image: all clicks differ in it."""


class Heard:
    """Listens, from the beginning of its life on.

    Args:
        link, keys: of the session to use; it must outlive this.
        operator: whose receipts.
    """

    def __init__(self, link: Link, keys: Keys, operator: str) -> None:
        self._lock = threading.Lock()
        self._sets: dict[Pair, PairCorrespondences] = {}
        self._receipted_s: list[float] = []
        link.on_latched(keys.receipts(operator), self._note_receipts)
        link.on_latched(keys.correspondences("*", "*"), self._note_set)

    def first_receipt_s(self, since_s: float) -> float | None:
        """When the first receipt of something new came after a time."""
        with self._lock:
            return next((at_s for at_s in self._receipted_s if at_s > since_s), None)

    def longest_gap_s(self, since_s: float, until_s: float) -> float:
        """The longest time without a receipt of something new, ends included."""
        with self._lock:
            times = [at_s for at_s in self._receipted_s if since_s < at_s < until_s]
        return max(b - a for a, b in itertools.pairwise((since_s, *times, until_s)))

    def heard_all(self, epoch: str) -> bool:
        """Whether all sets that are known are what a server of that epoch told."""
        with self._lock:
            return all(known.server_epoch == epoch for known in self._sets.values())

    def ids(self) -> dict[Pair, set[int]]:
        """Of the correspondences that are there, by pair."""
        with self._lock:
            return {pair: {item.id for item in known.items} for pair, known in self._sets.items()}

    def _settle(self, receipts: Receipts) -> bool:
        """Takes receipts in; whether they tell of anything new."""
        raise NotImplementedError

    def _note_receipts(self, sample: Sample) -> None:
        try:
            receipts = codec.unpack(Receipts, sample.payload, sample.encoding)
        except CodecError:
            return
        with self._lock:
            if self._settle(receipts):
                self._receipted_s.append(time.monotonic())

    def _note_set(self, sample: Sample) -> None:
        try:
            known = codec.unpack(PairCorrespondences, sample.payload, sample.encoding)
        except CodecError:
            return
        with self._lock:
            self._sets[known.i, known.j] = known


def clicked(pair: Pair, item: Correspondence) -> Click:
    """A correspondence as it was clicked."""
    return (*pair, float(item.pixel_i[0]), float(item.pixel_i[1]))
