"""A crowd of connections that break off before they show a certificate, with and without the packet
filter that `pose-deploy install` writes: how long does a new client wait? In a network namespace of
its own, so that no filter stays on this machine.
"""

import json
import secrets
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.deploy.machine.bundle import read_bundle
from fleetpose.deploy.machine.system_files import System, system_files
from fleetpose.evaluation.system.field.site import Field, no_password
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import SessionSettings, open_session

CROWD = 200
FROM = "127.0.0.2"
"""The crowd's address; who is let in has another one."""
OPENS_WITHIN_S = 90.0
_CALM_S = 0.5
_CONNECTS_S = 0.2
_UP_S = 30.0


def run(folder: Path, logs: Path) -> dict[str, Any]:
    """Has a crowd come without and with the filter.

    Returns:
        Seconds until a new client is in; why not, where this machine cannot tell.

    Raises:
        FleetPoseError: no client is let in at all.
    """
    if missing := [name for name in ("ip", "nft") if shutil.which(name) is None]:
        return _skipped(f"there is no {missing[0]}")
    with _namespace() as inside:
        if inside is None:
            return _skipped("no network namespace can be made")
        site = Field(folder)
        there = site.install("router/a")
        files, _ = system_files(
            read_bundle(site.bundle("router/a"), no_password).manifest, there, System.SYSTEMD
        )
        [rules] = (one.content for one in files if one.path.name == "fleetpose.nft")
        (folder / "fleetpose.nft").write_bytes(rules)
        arguments = (there / "zenoh.json5", site.configuration("operator/anna"))
        more = (str(site.router().port), folder / "fleetpose.nft", logs)
        module = "fleetpose.evaluation.system.field.handshakes"
        command = [*inside, sys.executable, "-P", "-m", module, *map(str, (*arguments, *more))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FleetPoseError(f"handshakes: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout.splitlines()[-1])


def _skipped(why: str) -> dict[str, Any]:
    print(f"handshakes are not measured: {why} here")
    return {"handshakes": why}


@contextmanager
def _namespace() -> Iterator[tuple[str, ...] | None]:
    """What a command is put behind to run in a namespace; None where none can be made."""
    name = f"fleetpose-{secrets.token_hex(3)}"
    if subprocess.run(["ip", "netns", "add", name], capture_output=True, check=False).returncode:
        yield None
        return
    inside = ("ip", "netns", "exec", name)
    try:
        subprocess.run([*inside, "ip", "link", "set", "lo", "up"], check=True)
        yield inside
    finally:
        subprocess.run(["ip", "netns", "del", name], check=False)


def measure(router: Path, client: Path, port: int, rules: Path, logs: Path) -> dict[str, float]:
    """Inside the namespace: a router, and a new client when all is calm, and after each crowd.

    Args:
        router: its configuration.
        client: the configuration of who wants to come in.
        port: of the router on 127.0.0.1.
        rules: for `nft -f`.
        logs: of the router.
    """
    told: dict[str, float] = {}
    with LocalFleet(logs) as fleet:
        fleet.start("router-crowded", "fleetpose.pose_server", "router", "--config", str(router))
        _opened_s(client, _UP_S)
        told["handshakes_calm_s"] = _calm_s(client)
        crowd(port)
        told["handshakes_without_filter_s"] = _opened_s(client, OPENS_WITHIN_S)
        _calm_s(client)
        subprocess.run(["nft", "-f", str(rules)], check=True)
        crowd(port)
        told["handshakes_with_filter_s"] = _opened_s(client, OPENS_WITHIN_S)
    return told


def crowd(port: int) -> None:
    """Connections that are opened all at once, and broken off."""
    sockets = [socket.socket() for _ in range(CROWD)]
    for one in sockets:
        one.bind((FROM, 0))
        one.setblocking(False)
        one.connect_ex(("127.0.0.1", port))
    time.sleep(_CONNECTS_S)
    for one in sockets:
        with suppress(OSError):
            one.close()


def _opened_s(client: Path, within_s: float) -> float:
    began_s = time.monotonic()
    open_session(SessionSettings(config_file=client, timeout_s=within_s)).close()
    return time.monotonic() - began_s


def _calm_s(client: Path) -> float:
    """How long it takes once nobody else comes any more."""
    end_s = time.monotonic() + OPENS_WITHIN_S
    while (took_s := _opened_s(client, OPENS_WITHIN_S)) > _CALM_S and time.monotonic() < end_s:
        pass
    return took_s


def main() -> None:
    """Arguments ROUTER CLIENT PORT RULES LOGS, inside the namespace."""
    router, client, port, rules, logs = sys.argv[1:]
    print(json.dumps(measure(Path(router), Path(client), int(port), Path(rules), Path(logs))))


if __name__ == "__main__":
    main()
