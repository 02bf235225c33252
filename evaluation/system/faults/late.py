"""Clicks made half a minute after the images were frozen, of robots that go on sending."""

import re
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.system.faults.desk import clickable, operator, replayed_fleet
from fleetpose.evaluation.system.faults.heard import Pair
from fleetpose.evaluation.system.fleet import FleetPlan
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.outbox import Ticket
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import ViewName
from fleetpose.protocol.transport import wait_until

ROBOTS = 5
DESKS = 10
LATE_S = 30.0
FREEZE_WITHIN_S = 60.0
SETTLED_WITHIN_S = 60.0
_UNKNOWN = ("not kept", "no robot", "unknown")
CLICKS_PER_ROUND = 50


def run(
    clicks: int, scratch: Path, logs: Path, progress: Callable[[], None], late_s: float = LATE_S
) -> dict[str, Any]:
    """Ten operators freeze their images, wait and click, until there are so many clicks.

    Returns:
        How many clicks were made, accepted, rejected as unknown, rejected for another reason, and
        placed in the fleet's graph in the end.

    Raises:
        FleetPoseError: the fleet does not come up, or clicks are not receipted.
    """
    tickets: list[Ticket] = []
    with replayed_fleet(ROBOTS, scratch, logs) as (fleet, plan, observer):
        pairs = [one.pair for one in clickable(fleet, plan, observer)]
        with ExitStack() as desks:
            sessions = [
                desks.enter_context(
                    operator(f"op-{k}", fleet.endpoint, fleet.site, pairs[k % len(pairs)])
                )
                for k in range(DESKS)
            ]
            while len(tickets) < clicks:
                share = min(CLICKS_PER_ROUND, -(-(clicks - len(tickets)) // DESKS))
                tickets += _round(fleet, plan, observer, sessions, share, late_s, progress)
            placed = _placed(fleet, sessions[0], pairs, sum(t.accepted for t in tickets))
    reasons = Counter(_kind(t.reason) for t in tickets if t.reason is not None)
    unknown = sum(n for reason, n in reasons.items() if any(word in reason for word in _UNKNOWN))
    return {
        "late_clicks": len(tickets),
        "late_accepted": sum(t.accepted for t in tickets),
        "late_rejected_unknown": unknown,
        "late_rejected_otherwise": dict(reasons) if sum(reasons.values()) > unknown else {},
        "late_placed": placed,
        "late_views": len({view for t in tickets if t.pick for view in _views(t)}),
    }


def _round(
    fleet: LocalFleet,
    plan: FleetPlan,
    observer: Observer,
    sessions: list[OperatorSession],
    clicks: int,
    late_s: float,
    progress: Callable[[], None],
) -> list[Ticket]:
    """Every operator freezes, waits, clicks and lets go; each holds other views."""
    held: dict[ViewName, SeenView] = {}
    for session in sessions:
        new = partial(_shows_two_but, session, set(held), observer)
        if not wait_running(fleet, new, FREEZE_WITHIN_S):
            raise FleetPoseError(f"{session.operator} gets no images; logs: {fleet.directory}")
        session.toggle_freeze()
        frozen = {view: observer.view(view) for view in session.frozen_views()}
        held |= {view: seen for view, seen in frozen.items() if seen is not None}
    end_s = time.monotonic() + late_s
    while time.monotonic() < end_s:
        wait_until(lambda: time.monotonic() >= end_s, 1.0)
        progress()
    tickets = []
    for session in sessions:
        tickets += _click(plan, held, session, clicks)
        session.toggle_freeze()
    if not wait_running(fleet, lambda: all(t.final for t in tickets), SETTLED_WITHIN_S):
        raise FleetPoseError(f"late clicks are not receipted; logs: {fleet.directory}")
    return tickets


def _shows_two_but(session: OperatorSession, held: set[ViewName], observer: Observer) -> bool:
    """Whether two views are shown that nobody holds yet, and of which the truth is known: who
    observes may have been overtaken by newer ones.
    """
    shown = _shown(session) - held
    return len(shown) == 2 and all(observer.view(view) is not None for view in shown)


def _shown(session: OperatorSession) -> set[ViewName]:
    """The views of the pictures that are there."""
    pictures = [session.picture(robot) for robot in session.pair or ()]
    return {picture.view for picture in pictures if picture is not None}


def _click(
    plan: FleetPlan, held: dict[ViewName, SeenView], session: OperatorSession, clicks: int
) -> list[Ticket]:
    """Clicks true correspondences of the two frozen views."""
    seen = [held[view] for view in session.frozen_views() if view in held]
    if len(seen) != 2:
        raise FleetPoseError(f"{session.operator} holds other views than were seen")
    i, j = seen
    uv_i, uv_j = plan.truth.correspondences(i, j)
    names = i.view.name, j.view.name
    chosen = np.random.default_rng(names[0].seq).permutation(len(uv_i))[:clicks]
    return [session.add(names[0], _uv(uv_i[k]), names[1], _uv(uv_j[k])) for k in chosen]


def _placed(fleet: LocalFleet, session: OperatorSession, pairs: list[Pair], accepted: int) -> int:
    """How many correspondences the solution has judged, once that is all of them."""

    def items() -> list[str]:
        return [c.status for pair in pairs if (s := session.sets().get(pair)) for c in s.items]

    def all_judged() -> bool:
        return len(found := items()) >= accepted and "unused" not in found

    wait_running(fleet, all_judged, SETTLED_WITHIN_S)
    return sum(status != "unused" for status in items())


def _views(ticket: Ticket) -> tuple[ViewName, ...]:
    u = ticket.update
    return tuple(view for view in (u.view_i, u.view_j) if view is not None)


def _uv(pixel: np.ndarray) -> tuple[float, float]:
    return float(pixel[0]), float(pixel[1])


def _kind(reason: str) -> str:
    """A reason without what differs from click to click."""
    return re.sub(r"\S+/\S+/\d+", "_", re.sub(r"^\w+: ", "", re.sub(r"\b\d+\b", "_", reason)))
