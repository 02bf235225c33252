"""Sending clicks from a command: in batches, waiting for receipts, telling what became of them."""

import math
import time
from collections.abc import Callable

import typer

from fleetpose.hmi_client.desk.words import why_unconfirmed
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.records import Pair, Pick
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.protocol.keys import ordered_pair
from fleetpose.protocol.messages import ViewName

BATCH = 50  # receipts name the newest 100 rejections: more at once could hide one
SET_TIMEOUT_S = 1.0
_NOT_KNOWN = "the server is there, but whether it has them is not known"


def add_all(session: OperatorSession, picks: list[Pick], timeout_s: float) -> int:
    """Sends picks in batches and prints what became of them; returns the exit code."""
    code = 0
    for start in range(0, len(picks), BATCH):
        batch = picks[start : start + BATCH]
        tickets = [session.add(p.view_i, p.pixel_i, p.view_j, p.pixel_j) for p in batch]
        if not finish(session, tickets, timeout_s):
            left = len(picks) - start - len(batch)
            if left:
                typer.echo(f"{left} were not sent", err=True)
            return report(session, tickets, [name_of(session, t) for t in tickets])
        code = max(code, report(session, tickets, [name_of(session, t) for t in tickets]))
    return code


def finish(session: OperatorSession, tickets: list[Ticket], timeout_s: float) -> bool:
    """Waits for the receipts, and a moment longer for the ids; whether all are final."""
    final = _wait(session, lambda: all(t.final for t in tickets), timeout_s)
    adds = [t for t in tickets if t.accepted and t.pick is not None]
    _wait(session, lambda: all(session.find(t.pick) is not None for t in adds), SET_TIMEOUT_S)
    return final


def _wait(session: OperatorSession, done: Callable[[], bool], timeout_s: float) -> bool:
    end = time.monotonic() + timeout_s
    while not done():
        seen = session.revisions()
        if done():
            break
        left = end - time.monotonic()
        if left <= 0 or not session.wait_change(seen, ("updates", "correspondences"), left):
            return done()
    return True


def name_of(session: OperatorSession, ticket: Ticket) -> str:
    """How an added correspondence is called in the output."""
    id = session.find(ticket.pick)
    i, j = ticket.update.i, ticket.update.j
    return f"accepted {i} - {j}" + (f", id {id}" if id is not None else "")


def report(session: OperatorSession, tickets: list[Ticket], names: list[str]) -> int:
    """Prints one line per ticket; returns the exit code."""
    for ticket, name in zip(tickets, names, strict=True):
        if ticket.accepted:
            typer.echo(name)
        elif ticket.final:
            typer.echo(f"rejected {ticket.update.i} - {ticket.update.j}: {ticket.reason}", err=True)
    open_ = sum(not ticket.final for ticket in tickets)
    if open_:
        typer.echo(
            f"{open_} not confirmed in time: {why_unconfirmed(session) or _NOT_KNOWN}; "
            "look with 'hmi-client correspondences list' before you send them again",
            err=True,
        )
        return 3
    return 1 if any(ticket.reason is not None for ticket in tickets) else 0


def four_numbers(point: str) -> tuple[float, float, float, float]:
    """Parses U1,V1,U2,V2.

    Raises:
        OperatorError: these are not four finite numbers.
    """
    try:
        numbers = [float(number) for number in point.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 4 or not all(math.isfinite(number) for number in numbers):
        raise OperatorError(f"'{point}' is no point: write U1,V1,U2,V2, e.g. 320,240,301.5,238")
    return numbers[0], numbers[1], numbers[2], numbers[3]


def ordered(session: OperatorSession, robot_1: str, robot_2: str) -> Pair:
    """The pair of two known robots."""
    if robot_1 == robot_2:
        raise OperatorError(f"'{robot_1}' and '{robot_2}' are one robot; a pair needs two")
    for robot in (robot_1, robot_2):
        session.robot(robot)
    return ordered_pair(robot_1, robot_2)


def newest(session: OperatorSession, robot: str, seq: int | None) -> ViewName:
    """A robot's newest view, or that with a number of the same life of its agent."""
    view = session.robot(robot).newest_view
    if view is None:
        raise OperatorError(f"{robot} has sent no view yet; a correspondence needs one")
    return view if seq is None else view.model_copy(update={"seq": seq})


def wait_for_sets(session: OperatorSession) -> None:
    """Waits until the sets hold what a new state counts.

    Sets are latched apart from the state, and the first state that a command hears may be the
    latched one, older than a click that has just been confirmed to another command.
    """
    first = session.fleet

    def all_here() -> bool:
        if session.fleet is None or session.fleet is first:
            return False
        cells = session.fleet.pairs
        here = {pair: len(known.items) for pair, known in session.sets().items()}
        return all(here.get((c.i, c.j), 0) == c.correspondences for c in cells)

    end = time.monotonic() + SET_TIMEOUT_S
    while not all_here() and time.monotonic() < end:
        seen = session.revisions()
        session.wait_change(seen, ("correspondences", "fleet"), 0.1)


def pairs_with_any(session: OperatorSession) -> list[Pair]:
    """The pairs that have correspondences, sorted."""
    return sorted(pair for pair, known in session.sets().items() if known.items)
