"""Complete zenoh configurations: of a router, and of everybody who connects to routers.

They are JSON, which zenoh (and `zenohd -c`) reads as JSON5.
"""

import hashlib
import json
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import Any

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import CA, CERTIFICATE, KEY, RouterAddress

ROOT = PurePosixPath("/etc/fleetpose")
"""Where bundles are installed unless somebody says otherwise."""

LEASE_MS = 2000
OPEN_MS = 1500
"""An endpoint that swallows packets costs so long, then the next one is asked."""
SEND_BUFFER = 65_536
"""Bytes of a client's socket: what is queued in a larger one can no longer be overtaken."""
BATCH = 16_384
"""Bytes that are sent as one, and read as one within the lease: a link that carries less than a
batch in that time breaks, with zenoh's usual 64 kB below 260 kbit/s. So much fits in one record of
TLS, and what is urgent waits for one at most. Of two ends the smaller counts."""
LARGEST_MESSAGE = 4 << 20
LOOPBACK = ("127.0.0.1", "localhost", "::1")


def client_configuration(
    site: str, who: Identity, routers: Sequence[RouterAddress]
) -> dict[str, Any]:
    """For a robot, the server, an operator: connects to any of the routers.

    Links that stand do not end with the certificate: a router whose own certificate was forgotten
    must not take the whole site down. Routers close the links of clients that have expired.
    """
    endpoints = [f"{router.endpoint}#so_sndbuf={SEND_BUFFER}" for router in routers]
    retry = {"period_init_ms": 200, "period_max_ms": 2000, "period_increase_factor": 1.5}
    return {
        "mode": "client",
        **_quiet(),
        "metadata": _metadata(site, who),
        "timestamping": {"enabled": True},
        "connect": {"endpoints": endpoints, "timeout_ms": 0, "retry": retry},
        "transport": {
            "unicast": {"open_timeout": OPEN_MS, "accept_timeout": 4000},
            **_link(_client_tls(who, close=False)),
        },
    }


def router_configuration(
    site: str,
    who: Identity,
    here: RouterAddress,
    others: Sequence[RouterAddress],
    access: dict[str, Any],
    limits: dict[str, Any],
) -> dict[str, Any]:
    """For a router: listens on all addresses of its machine, links to the routers before it."""
    every_address = f"tls/{'[::]' if ':' in here.host else '0.0.0.0'}:{here.port}"
    listen = here.endpoint if here.host in LOOPBACK else every_address
    folder = ROOT / who.folder
    tls = {
        "listen_private_key": str(folder / KEY),
        "listen_certificate": str(folder / CERTIFICATE),
        **_client_tls(who, close=True),
    }
    return {
        "mode": "router",
        **_quiet(),
        "metadata": _metadata(site, who, rules=rules_hash(access, limits)),
        "listen": {"endpoints": [listen]},
        "connect": {
            "endpoints": [router.endpoint for router in others],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 200, "period_max_ms": 2000},
        },
        "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
        "transport": {
            "unicast": {
                "open_timeout": 4000,
                "accept_timeout": 4000,
                "accept_pending": 50,
                "max_sessions": 1000,
            },
            **_link(tls),
        },
        "access_control": access,
        **limits,
    }


def rules_hash(access: dict[str, Any], limits: dict[str, Any]) -> str:
    """Twelve digits that name a set of rules: what a router runs can be compared by them."""
    text = json.dumps([access, limits], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def text_of(configuration: dict[str, Any]) -> str:
    """As a file."""
    return json.dumps(configuration, indent=1) + "\n"


def _metadata(site: str, who: Identity, **more: str) -> dict[str, Any]:
    """What our processes read of themselves; zenoh passes it by."""
    return {"fleetpose": {"site": site, "role": who.role, "name": who.name, **more}}


def _quiet() -> dict[str, Any]:
    return {"scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}}}


def _link(tls: dict[str, Any]) -> dict[str, Any]:
    return {
        "shared_memory": {"enabled": False},
        "link": {
            "protocols": ["tls"],
            "tx": {"lease": LEASE_MS, "keep_alive": 4, "batch_size": BATCH},
            "rx": {"max_message_size": LARGEST_MESSAGE},
            "tls": tls,
        },
    }


def _client_tls(who: Identity, close: bool) -> dict[str, Any]:
    folder = ROOT / who.folder
    return {
        "root_ca_certificate": str(folder / CA),
        "connect_private_key": str(folder / KEY),
        "connect_certificate": str(folder / CERTIFICATE),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": close,
    }
