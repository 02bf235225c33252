"""The operator's correspondences as far as this client knows them.

The server's sets, own updates on their way, what was rejected, undo and redo.
"""

import time
from collections.abc import Callable, Container
from dataclasses import dataclass, field, replace

from fleetpose.hmi_client.assist.deferred_clear import HeldClear
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import Deed, Entry, Pair, Pick, PixelUV
from fleetpose.hmi_client.network.outbox import Outbox, Ticket
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.messages import Correspondence, PairCorrespondences, Receipts, ViewName


@dataclass(frozen=True)
class UndoStep:
    """One step that can be undone: the picks it added and those it removed; of one that was moved,
    where it was and where it went.
    """

    added: tuple[Pick, ...] = ()
    removed: tuple[Pick, ...] = ()
    moved: tuple[Pick, Pick] | None = None


@dataclass
class CorrespondenceModel:
    """Keeps the server's word apart from the operator's wishes; the server's sets are the truth."""

    operator: str
    session: str | None = None
    sets: dict[Pair, PairCorrespondences] = field(default_factory=dict)
    clock: Callable[[], float] = time.monotonic
    kept: UpdateLog | None = None

    def __post_init__(self) -> None:
        self.outbox = Outbox(self.operator, self.session, self.kept)
        self._done: list[UndoStep] = []
        self._undone: list[UndoStep] = []
        self._settling: list[Ticket] = []  # accepted, but the set that shows it is still to come
        self._withdrawn: list[Pick] = []  # undone before it was named: erased once it is
        self._erasing: dict[Pair, dict[int, Ticket]] = {}
        self._moving: dict[Pair, dict[int, Ticket]] = {}
        self._clears: list[HeldClear] = []
        self._rejected: dict[Pair, list[tuple[Pick, str]]] = {}

    # ---- what the operator does ------------------------------------------------------------------

    def add(self, view_a: ViewName, pixel_a: PixelUV, view_b: ViewName, pixel_b: PixelUV) -> Ticket:
        pick = Pick.of(view_a, pixel_a, view_b, pixel_b)
        self.dismiss(pick.pair)
        self._remember(UndoStep(added=(pick,)))
        return self._post_add(pick)

    def erase(self, pair: Pair, id: int) -> Ticket:
        known = self._known(pair, id)
        self._remember(UndoStep(removed=(Pick.made_by(known),)))
        return self._post_erase(pair, known)

    def move(self, pair: Pair, id: int, side: int, pixel: PixelUV) -> Ticket:
        known = self._known(pair, id)
        if id in self._moving.get(pair, {}):
            raise OperatorError(f"{id} is being moved already: wait for the server")
        before = Pick.made_by(known)
        after = replace(before, **{"pixel_j" if side else "pixel_i": pixel})
        self._remember(UndoStep(moved=(before, after)))
        return self._post_move(known, after)

    def clear(self, pair: Pair) -> Ticket | None:
        """Erases what the set holds and own picks on their way; it is held until these are final,
        since it names the revision of the set that they make.
        """
        items, coming = self._items(pair), self._coming(pair)
        if not items and not coming:
            return None
        picks = (*(Pick.made_by(c) for c in items), *(t.pick for t in coming if t.pick))
        self._remember(UndoStep(removed=tuple(p for p in picks if p not in self._withdrawn)))
        self._withdrawn = [pick for pick in self._withdrawn if pick.pair != pair]
        known = self.sets.get(pair)
        ticket = self.outbox.post("clear", pair, known.revision if known else 0, held=True)
        seen = frozenset(c.id for c in known.items) if known else frozenset()
        self._clears.append(HeldClear(ticket, seen, coming))
        self._erasing.setdefault(pair, {}).update({c.id: ticket for c in items})
        return ticket

    def undo(self) -> Deed | None:
        return self._step(self._done, self._undone, forward=False)

    def redo(self) -> Deed | None:
        return self._step(self._undone, self._done, forward=True)

    def undoable(self) -> tuple[str | None, str | None]:
        """What undo and redo would do, in words."""
        return tuple(self._told(s[-1]).text if s else None for s in (self._done, self._undone))  # type: ignore[return-value]

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
        revisions = {c.id: c.revision for c in known.items}
        self._moving[pair] = {
            id: ticket
            for id, ticket in self._moving.get(pair, {}).items()
            if revisions.get(id, -1) == ticket.update.base_revision
        }
        for clear in self._clears:
            if clear.pair == pair:
                self._erasing[pair].update(dict.fromkeys(clear.named(known), clear.ticket))
        for ticket in (*self._settling, *self.outbox.open):
            ticket.arrived |= self._is_shown(ticket)
        self._settling = [ticket for ticket in self._settling if not ticket.arrived]
        self._erase_withdrawn()
        return True

    def on_receipts(self, receipts: Receipts) -> list[Ticket]:
        """Applies receipts; returns the tickets that became final."""
        settled = self.outbox.settle(receipts)
        for ticket in settled:
            self._settle(ticket)
        self._erase_withdrawn()
        return settled

    def sendable(self) -> tuple[Ticket, ...]:
        """Open tickets that can be sent now, in order."""
        for clear in tuple(self._clears):
            pair = clear.pair
            stale = any(t.update.i == pair[0] and t.update.j == pair[1] for t in self._settling)
            stale |= any(t.final for t in self._erasing.get(pair, {}).values())
            if clear.is_ready(self.outbox.open, stale, self.clock()):
                self._clears.remove(clear)
                self._settling = [t for t in self._settling if t not in clear.covers]
                erased = clear.release(self.sets.get(pair))
                self.outbox.keep(clear.ticket)
                self._erasing.setdefault(pair, {}).update(dict.fromkeys(erased, clear.ticket))
        return self.outbox.sendable

    def restart(self) -> None:
        """Begins anew with a server that has lost its journal: what it had accepted is gone."""
        for ticket in self.outbox.restart():
            self._settle(ticket)
        self._settling.clear()
        self._erasing.clear()
        self._moving.clear()
        for clear in self._clears:
            clear.seen = frozenset()

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
        items = sorted(known.items if known else (), key=lambda c: c.id)
        entries = [self._entry(c, self._moving.get(pair, {}).get(c.id), erasing) for c in items]
        cleared = {ticket for clear in self._clears for ticket in clear.covers}
        for ticket in (*self._settling, *self.outbox.open):
            if ticket.pick and ticket.pick.pair == pair and not ticket.arrived:
                erased = ticket in cleared or ticket.pick in self._withdrawn
                entries.append(Entry(ticket.pick, "erasing" if erased else "pending"))
        rejected = self._rejected.get(pair, [])
        return entries + [Entry(pick, "rejected", note=reason) for pick, reason in rejected]

    # ---- inside ----------------------------------------------------------------------------------

    def _known(self, pair: Pair, id: int) -> Correspondence:
        known = next((c for c in self._items(pair) if c.id == id), None)
        if known is None:
            ids = ", ".join(str(c.id) for c in self._items(pair)) or "none"
            raise OperatorError(f"{pair[0]}-{pair[1]} has no correspondence {id}; it has: {ids}")
        return known

    def _items(self, pair: Pair) -> tuple[Correspondence, ...]:
        """The pair's correspondences without those that are being erased."""
        known = self.sets.get(pair)
        erasing = self._erasing.get(pair, {})
        return tuple(c for c in known.items if c.id not in erasing) if known else ()

    def _named(self, pick: Pick) -> bool:
        return self.find(pick) is not None

    def _coming(self, pair: Pair) -> tuple[Ticket, ...]:
        """Own picks on their way that no set shows and no clear erases yet."""
        cleared = {ticket for clear in self._clears for ticket in clear.covers}
        return tuple(
            ticket
            for ticket in (*self._settling, *self.outbox.open)
            if ticket.pick and ticket.pick.pair == pair
            if not ticket.arrived and ticket not in cleared
        )

    def _is_shown(self, ticket: Ticket) -> bool:
        """Whether the set shows what a ticket added. The same pick may have been there before; that
        one is being erased by an update which came before the ticket.
        """
        if ticket.pick is None or ticket.pick.pair not in self.sets:
            return False
        erasing = self._erasing.get(ticket.pick.pair, {})
        for known in self.sets[ticket.pick.pair].items:
            eraser = erasing.get(known.id)
            later = eraser is None or eraser.update.n > ticket.update.n
            if later and Pick.made_by(known) == ticket.pick:
                return True
        return False

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

    def _entry(self, c: Correspondence, moving: Ticket | None, erasing: Container[int]) -> Entry:
        by = "" if c.operator == self.operator else c.operator
        if c.id in erasing:
            return Entry(Pick.made_by(c), "erasing", c.id, by=by)
        if moving is not None and moving.place is not None:
            return Entry(moving.place, "pending", c.id, by=by)
        return Entry(Pick.made_by(c), c.status, c.id, c.residual_m, c.residual_px, by=by)

    def _post_move(self, known: Correspondence, after: Pick) -> Ticket:
        ticket = self.outbox.post(
            "move",
            after.pair,
            known.revision,
            correspondence=known.id,
            view_i=after.view_i,
            view_j=after.view_j,
            pixel_i=after.pixel_i,
            pixel_j=after.pixel_j,
        )
        self._moving.setdefault(after.pair, {})[known.id] = ticket
        return ticket

    def _post_erase(self, pair: Pair, known: Correspondence) -> Ticket:
        ticket = self.outbox.post("erase", pair, known.revision, correspondence=known.id)
        self._erasing.setdefault(pair, {})[known.id] = ticket
        return ticket

    def _remember(self, deed: UndoStep) -> None:
        self._done.append(deed)
        self._undone.clear()

    def _step(self, source: list[UndoStep], target: list[UndoStep], forward: bool) -> Deed | None:
        if not source:
            return None
        deed = source[-1]
        told = self._told(deed)
        if deed.moved is not None:
            before, after = deed.moved if forward else deed.moved[::-1]
            known = self.find(before)
            if known is None or known.id in self._moving.get(before.pair, {}):
                return None  # the server is still to say that it was moved
            self._post_move(known, after)
        target.append(source.pop())
        added, removed = (deed.added, deed.removed) if forward else (deed.removed, deed.added)
        for pick in removed:
            self._withdraw(pick)
        for pick in added:
            self._put_back(pick)
        return told

    def _told(self, deed: UndoStep) -> Deed:
        """A step in words, with the numbers that its points have in the list, where they have."""
        picks = deed.moved or (*deed.added, *deed.removed)
        pair = picks[0].pair if picks else None
        listed = [entry.pick for entry in self.entries(pair)] if pair else []
        numbers = [str(listed.index(pick) + 1) for pick in picks if pick in listed]
        where = f" of {pair[0]}-{pair[1]}" if pair else ""
        if deed.moved:
            return Deed(pair, f"moving point {numbers[0] if numbers else ''}".rstrip() + where)
        if deed.removed:
            what = "a point" if len(picks) == 1 else f"{len(picks)} points"
            return Deed(pair, f"erasing {what}{where}")
        return Deed(pair, f"point {numbers[0] if numbers else ''}".rstrip() + where)

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
        if update.action == "move":
            if ticket.reason is not None:
                moving = self._moving.get(pair, {})
                self._moving[pair] = {id: t for id, t in moving.items() if t is not ticket}
                if ticket.place is not None:
                    self._rejected.setdefault(pair, []).append((ticket.place, ticket.reason))
        elif pick is None:
            if ticket.reason is not None:
                erasing = self._erasing.get(pair, {})
                self._erasing[pair] = {id: t for id, t in erasing.items() if t is not ticket}
        elif ticket.reason is not None:
            self._rejected.setdefault(pair, []).append((pick, ticket.reason))
            self._withdrawn = [other for other in self._withdrawn if other != pick]
        elif not ticket.arrived:
            self._settling.append(ticket)
