"""The operator's correspondences as far as this client knows them.

The server's sets, own updates on their way, what was rejected, undo and redo.
"""

from dataclasses import dataclass, field

from hmi_client.errors import OperatorError
from hmi_client.model import Entry, Pair, Pick, PixelUV
from hmi_client.outbox import Outbox, Ticket
from protocol.messages import Correspondence, PairCorrespondences, Receipts, ViewName


@dataclass(frozen=True)
class Deed:
    """One step that can be undone: the picks it added and those it removed."""

    added: tuple[Pick, ...] = ()
    removed: tuple[Pick, ...] = ()


@dataclass
class Workbook:
    """Keeps the server's word apart from the operator's wishes; the server's sets are the truth."""

    operator: str
    session: str | None = None
    sets: dict[Pair, PairCorrespondences] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.outbox = Outbox(self.operator, self.session)
        self._done: list[Deed] = []
        self._undone: list[Deed] = []
        self._settling: list[Ticket] = []  # accepted, but the set that shows it is still to come
        self._withdrawn: list[Pick] = []  # undone before it was named: erased once it is
        self._erasing: dict[Pair, dict[int, Ticket]] = {}
        self._rejected: dict[Pair, list[tuple[Pick, str]]] = {}

    # ---- what the operator does ------------------------------------------------------------------

    def add(self, view_a: ViewName, pixel_a: PixelUV, view_b: ViewName, pixel_b: PixelUV) -> Ticket:
        pick = Pick.of(view_a, pixel_a, view_b, pixel_b)
        self.dismiss(pick.pair)
        self._remember(Deed(added=(pick,)))
        return self._post_add(pick)

    def erase(self, pair: Pair, id: int) -> Ticket:
        known = next((c for c in self._items(pair) if c.id == id), None)
        if known is None:
            ids = ", ".join(str(c.id) for c in self._items(pair)) or "none"
            raise OperatorError(f"{pair[0]}-{pair[1]} has no correspondence {id}; it has: {ids}")
        self._remember(Deed(removed=(Pick.made_by(known),)))
        return self._post_erase(pair, known)

    def clear(self, pair: Pair) -> Ticket | None:
        items = self._items(pair)
        if not items:
            return None
        self._remember(Deed(removed=tuple(Pick.made_by(c) for c in items)))
        ticket = self.outbox.post("clear", pair, self.sets[pair].revision)
        self._erasing.setdefault(pair, {}).update({c.id: ticket for c in items})
        return ticket

    def undo(self) -> bool:
        return self._step(self._done, self._undone, forward=False)

    def redo(self) -> bool:
        return self._step(self._undone, self._done, forward=True)

    def dismiss(self, pair: Pair) -> bool:
        """Forgets the rejected picks of a pair; whether there were any."""
        return bool(self._rejected.pop(pair, None))

    # ---- what the server says --------------------------------------------------------------------

    def on_set(self, known: PairCorrespondences) -> bool:
        """Takes a set unless a newer one of the same server is known; whether it was taken."""
        pair = (known.i, known.j)
        old = self.sets.get(pair)
        if old and old.server_epoch == known.server_epoch and known.revision < old.revision:
            return False
        self.sets[pair] = known
        there = {c.id for c in known.items}
        erasing = self._erasing.get(pair, {})
        self._erasing[pair] = {id: ticket for id, ticket in erasing.items() if id in there}
        self._settling = [t for t in self._settling if not (t.pick and self._named(t.pick))]
        self._erase_withdrawn()
        return True

    def on_receipts(self, receipts: Receipts) -> list[Ticket]:
        """Applies receipts; returns the tickets that became final."""
        settled = self.outbox.settle(receipts)
        for ticket in settled:
            self._settle(ticket)
        self._erase_withdrawn()
        return settled

    def forget_other_servers(self, epoch: str) -> None:
        """Drops the sets of earlier server epochs: only the present server's word counts."""
        self.sets = {pair: s for pair, s in self.sets.items() if s.server_epoch == epoch}

    # ---- what is shown ---------------------------------------------------------------------------

    def find(self, pick: Pick) -> Correspondence | None:
        """The live correspondence that a pick has become; none if the server has not named it."""
        return next((c for c in self._items(pick.pair) if Pick.made_by(c) == pick), None)

    def entries(self, pair: Pair) -> list[Entry]:
        """The server's set in the order of its ids, then open picks, then rejected ones."""
        erasing = self._erasing.get(pair, {})
        known = self.sets.get(pair)
        entries = [
            Entry(
                Pick.made_by(c),
                "erasing" if c.id in erasing else c.status,
                c.id,
                c.residual_m,
                c.residual_px,
            )
            for c in sorted(known.items if known else (), key=lambda c: c.id)
        ]
        for ticket in (*self._settling, *self.outbox.open):
            if ticket.pick and ticket.pick.pair == pair and not self._named(ticket.pick):
                undone = ticket.pick in self._withdrawn
                entries.append(Entry(ticket.pick, "erasing" if undone else "pending"))
        rejected = self._rejected.get(pair, [])
        return entries + [Entry(pick, "rejected", note=reason) for pick, reason in rejected]

    # ---- inside ----------------------------------------------------------------------------------

    def _items(self, pair: Pair) -> tuple[Correspondence, ...]:
        """The pair's correspondences without those that are being erased."""
        known = self.sets.get(pair)
        erasing = self._erasing.get(pair, {})
        return tuple(c for c in known.items if c.id not in erasing) if known else ()

    def _named(self, pick: Pick) -> bool:
        return self.find(pick) is not None

    def _post_add(self, pick: Pick) -> Ticket:
        known = self.sets.get(pick.pair)
        return self.outbox.post(
            "add",
            pick.pair,
            known.revision if known else 0,
            view_i=pick.view_i,
            view_j=pick.view_j,
            pixel_i=pick.pixel_i,
            pixel_j=pick.pixel_j,
        )

    def _post_erase(self, pair: Pair, known: Correspondence) -> Ticket:
        ticket = self.outbox.post("erase", pair, known.revision, correspondence=known.id)
        self._erasing.setdefault(pair, {})[known.id] = ticket
        return ticket

    def _remember(self, deed: Deed) -> None:
        self._done.append(deed)
        self._undone.clear()

    def _step(self, source: list[Deed], target: list[Deed], forward: bool) -> bool:
        if not source:
            return False
        deed = source.pop()
        target.append(deed)
        added, removed = (deed.added, deed.removed) if forward else (deed.removed, deed.added)
        for pick in removed:
            self._withdraw(pick)
        for pick in added:
            self._put_back(pick)
        return True

    def _withdraw(self, pick: Pick) -> None:
        known = self.find(pick)
        if known is not None:
            self._post_erase(pick.pair, known)
        elif any(t.pick == pick for t in (*self._settling, *self.outbox.open)):
            self._withdrawn.append(pick)

    def _put_back(self, pick: Pick) -> None:
        if pick in self._withdrawn:
            self._withdrawn.remove(pick)
        elif not self._named(pick):
            self._post_add(pick)

    def _erase_withdrawn(self) -> None:
        for pick in tuple(self._withdrawn):
            known = self.find(pick)
            if known is not None:
                self._withdrawn.remove(pick)
                self._post_erase(pick.pair, known)

    def _settle(self, ticket: Ticket) -> None:
        update, pick = ticket.update, ticket.pick
        pair = (update.i, update.j)
        if pick is None:
            if ticket.reason is not None:
                erasing = self._erasing.get(pair, {})
                self._erasing[pair] = {id: t for id, t in erasing.items() if t is not ticket}
        elif ticket.reason is not None:
            self._rejected.setdefault(pair, []).append((pick, ticket.reason))
            self._withdrawn = [other for other in self._withdrawn if other != pick]
        elif not self._named(pick):
            self._settling.append(ticket)
