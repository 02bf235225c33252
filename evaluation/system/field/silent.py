"""`--silent`: a robot's link broken in ten ways before its agent starts, and in two while it runs.
Do the agent and `pose-deploy check` say why?
"""

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from pathlib import Path
from typing import Any

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.machine.check import State, check, utc_now
from fleetpose.deploy.manifest import CERTIFICATE, CONFIGURATION, KEY, MANIFEST
from fleetpose.deploy.site.certificates import Issued
from fleetpose.evaluation.options.field import FieldOptions
from fleetpose.evaluation.report.output import write_csv
from fleetpose.evaluation.system.field.clock import moved_clock
from fleetpose.evaluation.system.field.live import (
    Live,
    live,
    router_process,
    start_router,
    wait_accepting,
)
from fleetpose.evaluation.system.field.site import Field, listening_port
from fleetpose.protocol.transport import wait_until

WITHIN_S = 20.0
"""So long an agent is listened to, from the start of its process on, or from the break."""
UP_S = 30.0
END_S = 10.0
LOCATED = "agent located name="
ROBOT = "r1"
NOT_TRIED = "not tried"


@dataclass
class Break:
    """One way in which a robot's link does not work.

    Attributes:
        make: breaks it, given the folder of the robot's machine; may leave things to be ended.
        days_off: how far ahead the machine's clock is.
        words: of the cause; one of them must be in what is said.
        harmless: nothing is wrong but that a router is dead: the agent must be heard all the same.
        running: it is made while the agent runs, and is heard.
    """

    name: str
    make: Callable[[Path, ExitStack], object]
    words: str
    days_off: float = 0.0
    harmless: bool = False
    running: bool = False


def run(
    options: FieldOptions, folder: Path, logs: Path, only: Sequence[str] = ()
) -> dict[str, Any]:
    """Starts the agent of a robot on a machine broken in each way; each is told.

    Args:
        only: names of the ways; else all.

    Raises:
        FleetPoseError: the site does not come up.
    """
    with live(folder, logs, options.robots, ("a", "b"), located=False) as it:
        it.fleet.stop(ROBOT)
        rows = [_broken(it, one, logs) for one in _breaks(it) if not only or one.name in only]
    write_csv(logs.parent.parent / "silent.csv", list(rows[0]), rows)
    for row in rows:
        for who in ("agent", "check"):
            seconds = row[f"{who}_s"]
            said = "not named" if seconds is None else f"named after {seconds:.1f} s"
            print(f"{row['cause']}: {who}: {said}: {row[f'{who}_said'][:150]}")
    return {
        "causes": len(rows),
        "agent_tried": sum(row["agent_said"] != NOT_TRIED for row in rows),
        **{
            f"{who}_named": sum(row[f"{who}_s"] is not None for row in rows)
            for who in ("agent", "check")
        },
        **{
            f"{who}_slowest_s": max((r[f"{who}_s"] for r in rows if r[f"{who}_s"]), default=None)
            for who in ("agent", "check")
        },
    }


def _breaks(it: Live) -> Iterator[Break]:
    field, folder = it.field, it.field.folder
    authority = field.keeper.folder.authority()

    def certificate(issued: Issued) -> Callable[[Path, ExitStack], object]:
        return lambda machine, _: _put(machine, issued)

    def of_site(site: str) -> Callable[[Path, ExitStack], object]:
        def make(machine: Path, closing: ExitStack) -> None:
            del closing
            there = Field(folder / f"site-{site}", site=site).install(f"robot/{ROBOT}")
            for name in (CERTIFICATE, KEY):
                shutil.copy(there / name, machine / name)
            _tell(machine, certificate_sha256=_manifest(there)["certificate_sha256"])

        return make

    def other_router(machine: Path, closing: ExitStack) -> None:
        other = Field(folder / "site-elsewhere", site="elsewhere")
        closing.enter_context(other.start_router())
        _to(machine, other.router().port)

    def name(machine: Path, _: ExitStack) -> None:
        settings = machine / "robot.toml"
        settings.write_text(settings.read_text().replace(f'"{ROBOT}"', '"r2"'))

    def plain(machine: Path, closing: ExitStack) -> None:
        port = listening_port()
        router = [sys.executable, "-P", "-m", "fleetpose.pose_server", "router"]
        process = subprocess.Popen(
            [*router, "--listen", f"tcp/127.0.0.1:{port}"], stdout=subprocess.DEVNULL
        )
        closing.callback(process.wait)
        closing.callback(process.terminate)
        wait_until(lambda: _accepts(port), 15.0, poll_s=0.1)
        _to(machine, port)

    def no_route(machine: Path, closing: ExitStack) -> None:
        _to(machine, closing.enter_context(_full_backlog()))

    def first_dead(machine: Path, closing: ExitStack) -> None:
        del machine
        it.fleet.stop("router-a")
        closing.callback(start_router, it, "a")

    def all_dead(machine: Path, closing: ExitStack) -> None:
        first_dead(machine, closing)
        it.fleet.stop("router-b")
        closing.callback(start_router, it, "b")

    def expires(machine: Path, _: ExitStack) -> None:
        _put(machine, authority.issue(who, days=-0.01))
        for router in ("a", "b"):
            it.fleet.restart(router_process(router))
            wait_accepting(it, router)

    who = Identity("robot", ROBOT)
    yield Break("expired", certificate(authority.issue(who, days=-0.01)), "expired")
    stranger = authority.issue(replace(who, generation=7), days=9)
    yield Break("unknown to the rules", certificate(stranger), "rules")
    yield Break("other name", name, "r2.*r1|r1.*r2")
    yield Break("other site", of_site("other"), "(other|older) site")
    yield Break("older site of this name", of_site(field.site.site), "(other|older) site")
    yield Break("router of another site", other_router, "router of another site")
    yield Break("clock a day off", lambda *_: None, "clock", days_off=1.0)
    yield Break("no TLS there", plain, "no TLS")
    yield Break("no route", no_route, "no route")
    yield Break("first router dead", first_dead, "nothing listens", harmless=True)
    yield Break("all routers die", all_dead, "nothing listens", running=True)
    yield Break("it expires", expires, "expired", running=True)


def _broken(it: Live, one: Break, logs: Path) -> dict[str, Any]:
    """Breaks the link, listens to the agent and has the machine checked; then mends it."""
    machine = it.field.install(f"robot/{ROBOT}")
    robot = it.plan.robots[0]
    shutil.rmtree(machine)
    it.field.install(f"robot/{ROBOT}")
    settings = machine / "robot.toml"
    settings.write_text(f'name = "{ROBOT}"\ncamera = "{robot.camera}"\ndata = "{robot.data}"\n')
    clock = moved_clock(it.field.folder, one.days_off) if one.days_off else {}
    agent_s, agent_said = None, NOT_TRIED
    with ExitStack() as closing:

        def make() -> None:
            one.make(machine, closing)

        if not one.running:
            make()
        if clock is not None:
            agent_s, agent_said = _agent(machine, one, logs, clock, make if one.running else None)
        check_s, check_said = _checked(machine, one)
    for name in ("a", "b"):
        wait_accepting(it, name)
    return {
        "cause": one.name,
        "agent_s": agent_s,
        "check_s": check_s,
        "agent_said": agent_said,
        "check_said": check_said,
    }


def _checked(machine: Path, one: Break) -> tuple[float | None, str]:
    """Seconds until a step that is not in order names the cause, and what it says."""
    began_s, said = time.monotonic(), []
    clock = (lambda: utc_now() + timedelta(days=one.days_off)) if one.days_off else utc_now
    for step in check(machine, clock=clock):
        if step.state is not State.OK:
            said.append(step.text)
            if re.search(one.words, step.text):
                return time.monotonic() - began_s, step.text
    return None, "; ".join(said)


def _agent(
    machine: Path,
    one: Break,
    logs: Path,
    clock: Mapping[str, str],
    then: Callable[[], None] | None,
) -> tuple[float | None, str]:
    """Runs the agent; seconds until its log names the cause, and the line that does, else the last.

    Args:
        clock: variables of its environment.
        then: breaks the link, once the agent is located; seconds are counted from then on.
    """
    log = logs / f"agent-{one.name.replace(' ', '-')}.log"
    config = ("--config", str(machine / CONFIGURATION), "--settings", str(machine / "robot.toml"))
    command = [sys.executable, "-P", "-m", "fleetpose.robot_agent", "run", *config]
    words = LOCATED if one.harmless else one.words

    def naming(words: str) -> list[str]:
        return [line for line in _said(log) if re.search(words, line)]

    with log.open("wb") as output:
        began_s = time.monotonic()
        environment = {**os.environ, **clock}
        process = subprocess.Popen(command, stdout=output, stderr=output, env=environment)
        try:
            if then is not None:
                wait_until(lambda: bool(naming(LOCATED)), UP_S, poll_s=0.1)
                then()
                began_s = time.monotonic()
            wait_until(
                lambda: bool(naming(words)) or process.poll() is not None, WITHIN_S, poll_s=0.1
            )
            took_s = time.monotonic() - began_s
        finally:
            process.terminate()
            try:
                process.wait(END_S)
            finally:
                process.kill()
    found = naming(words)
    return (took_s if found else None), (found or [*_said(log)[-1:], "nothing"])[0]


def _said(log: Path) -> list[str]:
    """What an agent has said, without its file names: they are not what it names."""
    return [re.sub(r"/\S+", "", line) for line in log.read_text(errors="replace").splitlines()]


def _put(machine: Path, issued: Issued) -> None:
    (machine / CERTIFICATE).write_bytes(issued.pem)
    (machine / KEY).write_bytes(issued.key_pem or b"")
    _tell(machine, certificate_sha256=issued.der_sha256)


def _manifest(machine: Path) -> dict[str, Any]:
    return json.loads((machine / MANIFEST).read_text())


def _tell(machine: Path, **changed: Any) -> None:
    (machine / MANIFEST).write_text(json.dumps(_manifest(machine) | changed))


def _to(machine: Path, port: int) -> None:
    """Another router's address, in manifest and configuration."""
    _tell(machine, routers=[{"name": "a", "host": "127.0.0.1", "port": port}])
    told = json.loads((machine / CONFIGURATION).read_text())
    told["connect"]["endpoints"] = [f"tls/127.0.0.1:{port}"]
    (machine / CONFIGURATION).write_text(json.dumps(told))


def _accepts(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=0.5).close()
    except OSError:
        return False
    return True


@contextmanager
def _full_backlog() -> Iterator[int]:
    """A port whose connections are neither accepted nor refused, as behind a firewall."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        waiting = [socket.socket() for _ in range(4)]
        for one in waiting:
            one.setblocking(False)
            one.connect_ex(server.getsockname())
        yield server.getsockname()[1]
        for one in waiting:
            one.close()
