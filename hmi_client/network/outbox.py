"""The operator's updates on their way: numbered without gaps, kept until a receipt covers them, on
disk where there is a place for it.
"""

from dataclasses import dataclass
from itertools import takewhile
from typing import Any, Literal

from fleetpose.hmi_client.model.records import Pair, Pick
from fleetpose.hmi_client.network.update_log import Life, UpdateLog
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import OperatorUpdate, Receipts

Action = Literal["add", "move", "erase", "clear"]


@dataclass(eq=False)
class Ticket:
    """What became of one update: open, accepted, or rejected with the server's reason.

    The update may be numbered anew when the server has lost its journal; the ticket stays. One that
    is `held` is not sent yet, nor is what follows it: the server takes updates in order. `arrived`
    says that a set has shown what it added, maybe before the receipt.
    """

    update: OperatorUpdate
    final: bool = False
    reason: str | None = None
    held: bool = False
    arrived: bool = False

    @property
    def accepted(self) -> bool:
        return self.final and self.reason is None

    @property
    def pick(self) -> Pick | None:
        """The pick of an `add`, none for other actions."""
        return self.place if self.update.action == "add" else None

    @property
    def place(self) -> Pick | None:
        """The views and pixels of an `add` or a `move`."""
        u = self.update
        if u.view_i is None or u.view_j is None:
            return None
        assert u.pixel_i is not None and u.pixel_j is not None  # the message's own rule
        (u_i, v_i), (u_j, v_j) = u.pixel_i, u.pixel_j
        return Pick(u.view_i, u.view_j, (float(u_i), float(v_i)), (float(u_j), float(v_j)))


class Outbox:
    """Numbers updates 1, 2, 3, ... within a session and keeps those still to be offered.

    Args:
        operator: the operator's name.
        session: epoch of the session; random if none is given.
        kept: where updates are kept on disk; what is there is taken up again.
    """

    def __init__(
        self, operator: str, session: str | None = None, kept: UpdateLog | None = None
    ) -> None:
        self.operator = operator
        self.session = session or new_epoch()
        self.confirmed = 0
        self._confirmed_by: str | None = None
        self._last = 0
        self._open: list[Ticket] = []
        self._kept = kept
        if kept is not None:
            self._take_up(kept)

    def begin_after(self, n: int) -> None:
        """Numbers from n + 1 on: of a session that is known from there."""
        self.confirmed = self._last = n

    @property
    def last(self) -> int:
        """Number of the last update, 0 before the first."""
        return self._last

    @property
    def open(self) -> tuple[Ticket, ...]:
        """Tickets that no receipt covers yet, in order."""
        return tuple(self._open)

    @property
    def sendable(self) -> tuple[Ticket, ...]:
        """The open tickets up to the first that is held."""
        return tuple(takewhile(lambda ticket: not ticket.held, self._open))

    def post(
        self, action: Action, pair: Pair, base_revision: int, held: bool = False, **places: Any
    ) -> Ticket:
        """Makes the next update; `places` are the remaining fields of `OperatorUpdate`."""
        update = OperatorUpdate(
            operator=self.operator,
            session=self.session,
            n=self._last + 1,
            action=action,
            i=pair[0],
            j=pair[1],
            base_revision=base_revision,
            **places,
        )
        ticket = Ticket(update, held=held)
        self.keep(ticket)
        self._last += 1
        self._open.append(ticket)
        return ticket

    def keep(self, ticket: Ticket) -> None:
        """Keeps an update on disk, if there is a place for it and it is not held."""
        if self._kept is not None and not ticket.held:
            self._kept.keep(ticket.update)

    def settle(self, receipts: Receipts) -> list[Ticket]:
        """Applies cumulative receipts; returns the tickets that became final, in order."""
        if receipts.operator != self.operator or receipts.session != self.session:
            return []
        if min(receipts.n, self._last) > self.confirmed:
            self.confirmed = min(receipts.n, self._last)
            self._confirmed_by = receipts.server_epoch
        reasons = {rejection.n: rejection.reason for rejection in receipts.rejections}
        settled = [ticket for ticket in self._open if ticket.update.n <= receipts.n]
        self._open = [ticket for ticket in self._open if ticket.update.n > receipts.n]
        for ticket in settled:
            ticket.final = True
            ticket.reason = reasons.get(ticket.update.n)
        if settled and self._kept is not None:
            self._kept.settle(self.confirmed, self._confirmed_by)
        return settled

    def is_forgotten_by(self, receipts: Receipts) -> bool:
        """Whether a server no longer has what another receipted: its journal is lost.

        A receipt that is merely late comes from the server that has receipted more.
        """
        return (
            receipts.operator == self.operator
            and receipts.session == self.session
            and receipts.server_epoch != self._confirmed_by
            and receipts.n < self.confirmed
        )

    def restart(self) -> list[Ticket]:
        """Begins a new session, numbered from 1, for a server with an empty journal.

        Returns:
            Tickets that became final: what they would have erased is gone, and its id may come to
            mean another.
        """
        self.session = new_epoch()
        self.confirmed = 0
        pointless = [ticket for ticket in self._open if ticket.pick is None and not ticket.held]
        for ticket in pointless:
            ticket.final, ticket.reason = True, "the server has lost what this would erase"
        self._open = [ticket for ticket in self._open if not ticket.final]
        self._last = len(self._open)
        for n, ticket in enumerate(self._open, start=1):
            ticket.arrived = False
            ticket.update = ticket.update.model_copy(update={"session": self.session, "n": n})
        self._keep_all()
        return pointless

    def _take_up(self, kept: UpdateLog) -> None:
        """Goes on where the last client was killed. A number that is missing is of an update that
        was held: neither it nor what followed was sent.
        """
        life = kept.life()
        if life is not None:
            self.session, self.confirmed = life.session, life.confirmed
            self._confirmed_by = life.confirmed_by
            for n, update in enumerate(life.updates, start=life.confirmed + 1):
                self._open.append(Ticket(update.model_copy(update={"n": n})))
            self._last = self.confirmed + len(self._open)
        self._keep_all()

    def _keep_all(self) -> None:
        """Writes the session anew."""
        if self._kept is not None:
            unheld = tuple(ticket.update for ticket in self._open if not ticket.held)
            self._kept.begin(Life(self.session, self.confirmed, self._confirmed_by, unheld))
