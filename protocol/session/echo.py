"""What a session tells of a router whose TLS is in order: whether its rules know this machine, and
whether both clocks agree.

A machine says something on a key of its own, and hears it again by way of the router, which stamps
it with its clock.
"""

import json
import secrets
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.protocol.keys import Keys
from fleetpose.protocol.session import configuration
from fleetpose.protocol.session.identity import Identity, identity_of

ECHO_S = 1.5  # 15 times there and back over a poor radio link
CLOCKS_DIFFER_S = 300.0  # more than any two machines whose clocks are set
_REPEATED_S = 0.1


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


def echo(
    told: Mapping[str, Any],
    who: Identity,
    endpoints: Sequence[str],
    stop: threading.Event | None = None,
) -> Echo:
    """Opens two sessions; what the first puts the second should hear.

    Args:
        told: a zenoh configuration, of which `scouting` and `transport` are used.
        who: whose certificate it names.
        endpoints: of a router; of several, the first that answers.
        stop: ends the listening when it is set.
    """
    key = Keys(who.site).check(who.role, who.name, secrets.token_hex(4))
    stamps: list[float | None] = []
    came = threading.Event()

    def note(sample: zenoh.Sample) -> None:
        stamps.append(sample.timestamp.get_time().timestamp() if sample.timestamp else None)
        came.set()

    try:
        with client_of(told, endpoints) as says, client_of(told, endpoints) as hears:
            hears.declare_subscriber(key, note)
            for _ in range(int(ECHO_S / _REPEATED_S)):  # the subscription takes time to arrive
                says.put(key, b"")
                if came.wait(_REPEATED_S) or (stop is not None and stop.is_set()):
                    break
            server = came.is_set() and _shown(hears, Keys(who.site).server_alive("*"))
    except zenoh.ZError:
        return Echo(connected=False)
    return Echo(True, came.is_set(), stamps[0] if stamps else None, server)


def _shown(session: zenoh.Session, tokens: str) -> bool:
    """Whether there is any of these tokens."""
    return any(reply.ok is not None for reply in session.liveliness().get(tokens, timeout=ECHO_S))


@contextmanager
def client_of(told: Mapping[str, Any], endpoints: Sequence[str]) -> Iterator[zenoh.Session]:
    """A session to these endpoints alone, whose samples are stamped by the router.

    Raises:
        ZError: none answers.
    """
    client = {
        "mode": "client",
        "scouting": told["scouting"],
        "connect": {"endpoints": list(endpoints), "timeout_ms": 0},
        "transport": told["transport"],
    }
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(client)))
    try:
        yield session
    finally:
        session.close()


def fault_behind_tls(file: Path | None, stop: threading.Event | None = None) -> str:
    """What is wrong though a router is reached: its rules do not know this machine, or a clock is
    off. Empty where nothing is, or where the configuration does not say whose it is.

    Args:
        file: the zenoh configuration that this machine uses.
        stop: ends the asking when it is set; then nothing is found.

    Raises:
        EndpointError: it cannot be used.
    """
    config = None if file is None else configuration.read(file)
    who = None if config is None or file is None else identity_of(config, file)
    if config is None or who is None:
        return ""
    told = {part: config.get(part) for part in ("scouting", "transport")}
    heard = echo(told, who, config.endpoints, stop)
    if not heard.connected or (stop is not None and stop.is_set()):
        return ""
    return clock_fault(heard.router_s, time.time()) if heard.heard else unknown_to_rules(str(who))


def unknown_to_rules(who: str, router: str = "NAME") -> str:
    """That a router lets through nothing of a certificate that it accepts."""
    return (
        f"the router's rules do not know {who}: install rules/router-{router}.json5 there and "
        "restart it, or ask whether this machine was revoked"
    )


def clock_fault(router_s: float | None, now_s: float) -> str:
    """That this machine's clock is not the router's; empty where it is, or is not told.

    Args:
        router_s: the router's, seconds since 1970.
        now_s: this machine's.
    """
    off_s = 0.0 if router_s is None else now_s - router_s
    if abs(off_s) <= CLOCKS_DIFFER_S:
        return ""
    size_s = abs(off_s)
    size = f"{size_s / 86400:.1f} days" if size_s > 86000 else f"{size_s / 60:.0f} minutes"
    side = "ahead of" if off_s > 0 else "behind"
    return f"this machine's clock is {size} {side} the router's: set it"
