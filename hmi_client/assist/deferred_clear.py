"""Clearing a pair while own clicks in it are still on their way.

A `clear` names the revision of the set that its operator saw, so that nothing unseen is erased. Own
clicks on their way raise the revision; the clear is therefore held until the set shows them.
"""

from dataclasses import dataclass

from fleetpose.hmi_client.model.records import Pair, Pick
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.protocol.messages import PairCorrespondences

SET_S = 2.0  # after receipts the set follows at once; another operator may have erased from it


@dataclass
class HeldClear:
    """A clear that is not sent yet.

    Attributes:
        ticket: of the clear; its base revision is the one that was known when it was asked for.
        seen: ids that the set had then.
        covers: own clicks that were on their way then; they are erased as well.
    """

    ticket: Ticket
    seen: frozenset[int]
    covers: tuple[Ticket, ...]
    _settled_s: float | None = None

    @property
    def pair(self) -> Pair:
        return self.ticket.update.i, self.ticket.update.j

    def named(self, known: PairCorrespondences) -> list[int]:
        """The ids that a set gives to the clicks that are covered."""
        picks = {ticket.pick for ticket in self.covers}
        return [c.id for c in known.items if Pick.made_by(c) in picks]

    def is_ready(self, open_: tuple[Ticket, ...], stale: bool, now_s: float) -> bool:
        """Whether the revision is known.

        Args:
            open_: tickets that are not final.
            stale: whether the set lacks something that the server has accepted.
            now_s: the session's clock.
        """
        n = self.ticket.update.n
        if any((t.update.i, t.update.j) == self.pair and t.update.n < n for t in open_):
            return False
        if self._settled_s is None:
            self._settled_s = now_s
        return not stale or now_s - self._settled_s > SET_S

    def release(self, known: PairCorrespondences | None) -> list[int]:
        """Lets the clear go for a set; the ids that it will erase.

        Where the set holds what the operator has not seen, the revision stays as it was, and the
        server rejects the clear.
        """
        self.ticket.held = False
        if known is None:
            return []
        mine = set(self.named(known))
        if any(c.id not in self.seen and c.id not in mine for c in known.items):
            return []
        changed = {"base_revision": known.revision}
        self.ticket.update = self.ticket.update.model_copy(update=changed)
        return [c.id for c in known.items]
