"""What a session tells of a router: whether its rules know this machine, and which rules it runs.

A machine says something on a key of its own, and hears it again by way of the router, which stamps
it with its clock.
"""

import json
import secrets
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import zenoh

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import RouterAddress
from fleetpose.deploy.site.permissions import ADMIN
from fleetpose.protocol.keys import Keys

ECHO_S = 2.0
REPEATED_S = 0.1


@dataclass(frozen=True)
class Echo:
    """What came back.

    Attributes:
        connected: a session was opened.
        heard: the rules let this machine say and hear what it may.
        router_s: the router's clock as it passed, seconds since 1970.
        server: a pose server of the site shows itself there.
    """

    connected: bool
    heard: bool = False
    router_s: float | None = None
    server: bool = False


def echo(configuration: dict[str, Any], site: str, who: Identity, router: RouterAddress) -> Echo:
    """Opens two sessions to one router; what the first puts the second should hear."""
    key = Keys(site).check(who.role, who.name, secrets.token_hex(4))
    stamps: list[float | None] = []
    came = threading.Event()

    def note(sample: zenoh.Sample) -> None:
        stamps.append(sample.timestamp.get_time().timestamp() if sample.timestamp else None)
        came.set()

    try:
        with _opened(configuration, router) as says, _opened(configuration, router) as hears:
            hears.declare_subscriber(key, note)
            for _ in range(int(ECHO_S / REPEATED_S)):  # the subscription takes its time to arrive
                says.put(key, b"")
                if came.wait(REPEATED_S):
                    break
            server = _shown(hears, Keys(site).server_alive("*"))
    except zenoh.ZError:
        return Echo(connected=False)
    return Echo(True, came.is_set(), stamps[0] if stamps else None, server)


def _shown(session: zenoh.Session, tokens: str) -> bool:
    """Whether there is any of these tokens."""
    return any(reply.ok is not None for reply in session.liveliness().get(tokens, timeout=ECHO_S))


def running_rules(configuration: dict[str, Any], router: RouterAddress) -> dict[str, str] | None:
    """What a router tells of the rules it runs: `site`, `role`, `name`, `rules` (their hash).

    Returns:
        None where it does not answer: it is not reached, or its rules do not let who asks.
    """
    try:
        with _opened(configuration, router) as session:
            here = {str(zid) for zid in session.info.routers_zid()}
            for reply in session.get(ADMIN, timeout=ECHO_S):
                told = json.loads(reply.ok.payload.to_bytes()) if reply.ok is not None else {}
                if told.get("zid") in here:  # others of the site answer too
                    return (told.get("metadata") or {}).get("fleetpose")
    except zenoh.ZError:
        return None
    return None


@contextmanager
def _opened(configuration: dict[str, Any], router: RouterAddress) -> Iterator[zenoh.Session]:
    """A session to this router alone, whose samples are stamped by the router."""
    client = {
        "mode": "client",
        "scouting": configuration["scouting"],
        "connect": {"endpoints": [router.endpoint], "timeout_ms": 0},
        "transport": configuration["transport"],
    }
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(client)))
    try:
        yield session
    finally:
        session.close()
