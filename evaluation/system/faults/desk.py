"""A small fleet of replayed robots, and operators at their desks: the client's own session and
connection, without a screen.
"""

import itertools
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.system.faults.clicker import Places
from fleetpose.evaluation.system.faults.heard import Pair
from fleetpose.evaluation.system.fleet import (
    FleetPlan,
    observed,
    plan_world,
    replay_arguments,
    start,
    wait_started,
)
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.client import Client
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until

RATE_HZ = 5.0
MIN_PLACES = 60
UP_WITHIN_S = 90.0
HEARD_WITHIN_S = 10.0


@contextmanager
def replayed_fleet(
    robots: int, scratch: Path, logs: Path
) -> Iterator[tuple[LocalFleet, FleetPlan, Observer]]:
    """Robots that stand in the synthetic world and send at 5 Hz, a server, and an observer."""
    plan = plan_world([f"r{k + 1}" for k in range(robots)], scratch, moving=False, seed=0)
    with LocalFleet(logs) as fleet:
        start(fleet, FleetPlan((), plan.truth, plan.world), 2, scratch / "state")
        options = ("load", *fleet.connection, *replay_arguments(plan, RATE_HZ, frames=4))
        fleet.start("load", "fleetpose.evaluation", *options)
        with observed(fleet) as observer:
            wait_started(fleet, observer, robots)
            yield fleet, plan, observer


def clickable(
    fleet: LocalFleet, plan: FleetPlan, observer: Observer, least: int = MIN_PLACES
) -> list[Places]:
    """Where the pairs of robots can be clicked that see so many places in common, by the truth.

    Raises:
        FleetPoseError: there are none.
    """

    def seen() -> list[SeenView]:
        return [view for name in plan.names if (view := observer.newest_view(name)) is not None]

    wait_running(fleet, lambda: len(seen()) == len(plan.names), UP_WITHIN_S)
    in_order = sorted(seen(), key=lambda one: one.view.name.robot)  # as clicks name pairs
    pairs = itertools.combinations(in_order, 2)
    places = [Places(i, j, *plan.truth.correspondences(i, j)) for i, j in pairs]
    found = [one for one in places if len(one.uv_i) >= least]
    if not found:
        raise FleetPoseError(f"no two robots see the same; the logs are in {fleet.directory}")
    return found


@contextmanager
def operator(name: str, endpoint: str, site: str, pair: Pair | None) -> Iterator[OperatorSession]:
    """An operator's session, connected, with a pair selected once the server knows its robots.

    Raises:
        FleetPoseError: the server was not heard, or does not know them.
    """
    session = OperatorSession(name)
    settings = SessionSettings(connect=(endpoint,))
    with Client(session, Keys(site), lambda: Link(open_session(settings))):
        if pair is not None:
            known = wait_until(lambda: set(pair) <= set(session.robots()), HEARD_WITHIN_S)
            if not known:
                raise FleetPoseError(f"{name} hears of {session.robots()}, not of {pair}")
            session.select(*pair)
        yield session


def read(name: str, endpoint: str, site: str, pair: Pair) -> None:
    """Follows a fleet as the screen does and prints a line for each state: when, and its number.

    Runs until its standard output is closed or it is ended.
    """
    with operator(name, endpoint, site, pair) as session:
        told = -1
        while True:
            seen = session.revisions()
            if session.fleet is not None and session.fleet.n != told:
                told = session.fleet.n
                views = [p.view.seq if (p := session.picture(r)) else None for r in pair]
                line = {"at_s": time.monotonic(), "state": told, "pictures": views}
                print(json.dumps(line), flush=True)
            session.wait_change(seen, ("fleet",), 0.5)


def main() -> None:
    """Arguments NAME ENDPOINT SITE I J: what is frozen by `frozen`."""
    name, endpoint, site, i, j = sys.argv[1:]
    read(name, endpoint, site, (i, j))


if __name__ == "__main__":
    main()
