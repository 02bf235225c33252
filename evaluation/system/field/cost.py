"""`--cost`: what TLS and access control cost a fleet, beside a router without them; and how long
the way of the field's guide takes, from an empty folder to clicks that are receipted.
"""

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from fleetpose.deploy.manifest import CONFIGURATION
from fleetpose.deploy.site.folder import SiteFolder
from fleetpose.deploy.site.issuing import Keeper
from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.system.field.clicking import FLOWS_WITHIN_S, clicking
from fleetpose.evaluation.system.field.live import Live, live, router_process
from fleetpose.evaluation.system.field.site import Field, listening_port
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import wait_until

ROBOTS = 6
CLICKS_PER_S = 5.0
SETTLED_S, MEASURED_S = 5.0, 20.0
ORDER = ("plain", "secured", "secured", "plain")
"""Of two rounds the lower figures count: what the machine does besides only adds to them."""
JUDGED = ("click_p50_ms", "click_p95_ms", "server_cpu_s")
SECURITY = ("access_control", "downsampling", "low_pass_filter", "qos")


class Plain(Field):
    """A site whose machines are told to leave out TLS, access control and limits."""

    def install(self, who: str) -> Path:
        """Installs a bundle, then takes security out of its configuration."""
        folder = super().install(who)
        told = json.loads((folder / CONFIGURATION).read_text())
        del told["transport"]["link"]
        for part in SECURITY:
            told.pop(part, None)
        text = json.dumps(told).replace('"tls/', '"tcp/')
        (folder / CONFIGURATION).write_text(text)
        return folder


class ByCommands(Field):
    """A site that is made and installed by the commands of docs/field.md."""

    def __init__(self, folder: Path, robots: tuple[str, ...], routers: tuple[str, ...]) -> None:
        self.folder, self.keys = folder, Keys("hall")
        self._installed: dict[str, Path] = {}
        site = folder / "hall"
        where = [f"--router={name}=127.0.0.1:{listening_port()}" for name in routers]
        _deploy("init", site, "--site", "hall", *where)
        _deploy("add", site, "robot", *robots)
        _deploy("add", site, "operator", "anna", "ben")
        _deploy("add", site, "observer", "wall")
        self.keeper = Keeper(SiteFolder(site))

    def install(self, who: str) -> Path:
        """Installs a bundle, once."""
        if who not in self._installed:
            root = self.folder / "machines" / who.replace("/", "-")
            _deploy("install", self.bundle(who), "--root", root)
            [self._installed[who]] = (path.parent for path in root.glob(f"*/{CONFIGURATION}"))
        return self._installed[who]


def _deploy(*arguments: object) -> None:
    command = [sys.executable, "-P", "-m", "fleetpose.deploy", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise FleetPoseError(f"pose-deploy {arguments[0]}: {done.stderr.strip()}")


def run(options: FieldOptions, folder: Path, logs: Path) -> dict[str, Any]:
    """Measures both kinds of router in turn, then the way of the guide.

    Raises:
        FleetPoseError: a fleet does not come up, or clicks are not receipted.
    """
    del options
    rounds: dict[str, list[dict[str, float]]] = {"plain": [], "secured": []}
    for number, kind in enumerate(ORDER):
        make = Plain if kind == "plain" else Field
        name = f"{kind}-{number}"
        with live(folder / name, logs / name, ROBOTS, make=make) as it:
            rounds[kind].append(_measured(it))
        print(kind, {what: round(value, 2) for what, value in rounds[kind][-1].items()})
    told: dict[str, Any] = {"robots": ROBOTS}
    for what in rounds["plain"][0]:
        plain, secured = (min(one[what] for one in rounds[kind]) for kind in rounds)
        told |= {f"plain_{what}": plain, f"secured_{what}": secured}
        if what in JUDGED:
            told[f"{what}_ratio"] = secured / plain
    return {**told, **_by_guide(folder / "guide", logs / "guide")}


def _measured(it: Live) -> dict[str, float]:
    """Clicks at a person's hasty pace beside a fleet that is located: from the put of an update to
    its receipt, and CPU seconds.
    """
    with clicking(it, CLICKS_PER_S) as operator:
        _pass(SETTLED_S)
        began_s, before = time.monotonic(), _cpu_s(it)
        _pass(MEASURED_S)
        used_s = {f"{name}_cpu_s": now - before[name] for name, now in _cpu_s(it).items()}
        operator.clicker.pause()
        if not operator.clicker.settled(FLOWS_WITHIN_S):
            raise FleetPoseError(f"clicks are not receipted; the logs are in {it.fleet.directory}")
        waits_s = operator.clicker.waited_s(began_s, time.monotonic())
        p50_ms, p95_ms = 1e3 * np.percentile(waits_s, [50, 95])
    return {"click_p50_ms": float(p50_ms), "click_p95_ms": float(p95_ms), **used_s}


def _cpu_s(it: Live) -> dict[str, float]:
    """CPU seconds so far; what workers that ended have used is not known any more."""
    server = psutil.Process(it.fleet.pid("server"))
    router = psutil.Process(it.fleet.pid(router_process("a")))
    return {
        "server": _used_s(server),
        "server_workers": sum(_used_s(worker) for worker in server.children(recursive=True)),
        "router": _used_s(router),
    }


def _used_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return times.user + times.system


def _pass(seconds: float) -> None:
    end_s = time.monotonic() + seconds
    wait_until(lambda: time.monotonic() >= end_s, seconds + 1.0)


def _by_guide(folder: Path, logs: Path) -> dict[str, Any]:
    """By commands alone: seconds until the fleet is located, and until a client that came after the
    first receipts has heard of all robots and sets.
    """
    began_s = time.monotonic()
    with live(folder, logs, ROBOTS, make=ByCommands) as it:
        located_s = time.monotonic() - began_s
        with clicking(it, CLICKS_PER_S) as operator:
            receipted_s = time.monotonic() - began_s
            operator.clicker.pause()
            operator.clicker.settled(SETTLED_S)
            with it.client("operator/ben") as late:
                clicker = operator.clicker
                it.wait(lambda: _complete(late, clicker.ids()), "who joins late misses some", 30.0)
                complete_s = time.monotonic() - began_s
            receipted = operator.clicker.receipted
    return {
        "guide_located_s": located_s,
        "guide_receipted_s": receipted_s,
        "guide_receipted": receipted,
        "guide_late_client_s": complete_s,
        "guide_leftover_processes": it.fleet.leftover_processes(),
    }


def _complete(late: OperatorSession, ids: Mapping[tuple[str, str], set[int]]) -> bool:
    """Whether a client has all robots, and of each pair all correspondences."""
    sets = late.sets()
    had = {pair: {item.id for item in sets[pair].items} for pair in ids if pair in sets}
    return len(late.robots()) == ROBOTS and had == ids
