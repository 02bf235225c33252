"""A whole fleet as separate processes on this machine: for demo, evaluation and integration tests.

Every child is `sys.executable -P -m <package>` in a process group of its own, writes to
`<directory>/<name>.log`, and ends with its parent, however that ends.
"""

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, Self

from fleetpose.protocol.errors import FleetPoseError, UnreachableError
from fleetpose.protocol.transport import free_port, wait_until

GRACE_S = 3.0
ROBOT_NICE = 10
ROUTER_START_S = 15.0
_PR_SET_PDEATHSIG = 1
_libc = ctypes.CDLL(None)


class ProcessEndedError(FleetPoseError):
    """A process of the fleet ended although nobody asked it to; carries the end of its log."""


@dataclass
class _Child:
    """One process and how to start it again."""

    command: list[str]
    log: Path
    process: subprocess.Popen[bytes]
    nice: int = 0
    json_lines: Path | None = None
    told_to_end: bool = False


class LocalFleet:
    """Starts the processes of a fleet on 127.0.0.1 and ends them all.

    Use it as a context manager in the main thread: there, SIGTERM and SIGHUP of this process end
    the fleet just as Ctrl-C does.

    Args:
        directory: for the logs; made if missing.
        site: of all its keys.
    """

    def __init__(self, directory: Path, site: str = "demo") -> None:
        self.directory = directory
        self.site = site
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self._children: dict[str, _Child] = {}
        self._groups: set[int] = set()
        self._handlers: dict[int, object] = {}

    def __enter__(self) -> Self:
        self.directory.mkdir(parents=True, exist_ok=True)
        for signum in (signal.SIGTERM, signal.SIGHUP):
            self._handlers[signum] = signal.signal(signum, _leave)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
        for signum, handler in self._handlers.items():
            signal.signal(signum, handler)  # pyright: ignore[reportArgumentType]

    def start(
        self, name: str, module: str, *arguments: str, nice: int = 0, json_lines: bool = False
    ) -> int:
        """Starts `python -P -m module arguments` under a name; returns its process id.

        With `json_lines` its standard output goes to `<directory>/<name>.jsonl`, for `told`: in
        one file with the log, a line of one could end up within a line of the other.
        """
        command = [sys.executable, "-P", "-m", module, *arguments]
        log = self.directory / f"{name}.log"
        output = self.directory / f"{name}.jsonl" if json_lines else None
        process = self._spawn(command, log, output, nice)
        self._children[name] = _Child(command, log, process, nice, output)
        return process.pid

    def told(self, name: str) -> list[dict[str, Any]]:
        """What a process started with `json_lines` has written so far, whole lines only."""
        path = self._children[name].json_lines
        if path is None:
            raise ValueError(f"{name} was started without json_lines")
        whole, _, _ = path.read_text(errors="replace").rpartition("\n")
        return [json.loads(line) for line in whole.splitlines() if line]

    def start_router(self) -> None:
        """Starts the router and waits until it accepts connections.

        Raises:
            UnreachableError: it did not, within 15 s.
        """
        self.start("router", "fleetpose.pose_server", "router", "--listen", self.endpoint)
        self.wait_accepting()

    def wait_accepting(self) -> None:
        """Waits until the router accepts connections.

        Raises:
            UnreachableError: it does not, within 15 s.
        """
        ready = wait_until(
            lambda: self._accepts() or "router" in self.exited(), ROUTER_START_S, poll_s=0.05
        )
        if not ready or "router" in self.exited():
            raise UnreachableError(
                f"the router does not start; its log ends:\n{self.tail('router')}"
            )

    def start_server(self, *options: str, state: Path | None = None) -> None:
        """Starts the pose server; its journal is kept in `state`, else in `<directory>/state`."""
        where = ("--state-dir", str(state or self.directory / "state"))
        self.start("server", "fleetpose.pose_server", "run", *self.connection, *where, *options)

    def start_robot(self, name: str, camera: str, data: str, *options: str) -> None:
        """Starts a robot agent with a camera (`views`, `rgbd`, ...) and its folder or endpoint.

        In the field a robot has a computer of its own; here it must not take the server's.
        """
        source = ("--name", name, "--camera", camera, "--data", data)
        self.start(
            name,
            "fleetpose.robot_agent",
            "run",
            *self.connection,
            *source,
            *options,
            nice=ROBOT_NICE,
        )

    @property
    def connection(self) -> tuple[str, ...]:
        """The options by which every process of this fleet finds the others."""
        return ("--connect", self.endpoint, "--site", self.site)

    def pid(self, name: str) -> int:
        return self._children[name].process.pid

    def names(self) -> list[str]:
        return list(self._children)

    def kill(self, name: str) -> None:
        """SIGKILL to one process, as a crash would end it; its own children are left to notice."""
        child = self._children[name]
        child.told_to_end = True
        child.process.kill()
        child.process.wait()

    def signal(self, name: str, what: str) -> None:
        """Sends a signal, by its name, to one process."""
        self._children[name].process.send_signal(signal.Signals[what])

    def stop(self, name: str) -> None:
        """Ends one process and its children: SIGTERM, after 3 s SIGKILL."""
        self._end([self._children[name]])

    def restart(self, name: str) -> None:
        """Ends one process if it still runs and starts it again as before; its log goes on."""
        self.stop(name)
        child = self._children[name]
        process = self._spawn(child.command, child.log, child.json_lines, child.nice)
        self._children[name] = replace(child, process=process, told_to_end=False)

    def exited(self) -> dict[str, str]:
        """Names of the processes that ended unasked, with the last lines of their logs."""
        return {
            name: self.tail(name)
            for name, child in self._children.items()
            if not child.told_to_end and child.process.poll() is not None
        }

    def check(self) -> None:
        """Raises ProcessEndedError if a process ended unasked."""
        for name, last_lines in self.exited().items():
            raise ProcessEndedError(
                f"{name} ended; {self.directory / name}.log ends:\n{last_lines}"
            )

    def tail(self, name: str, lines: int = 15) -> str:
        """The last lines of a process's log."""
        text = self._children[name].log.read_text(errors="replace")
        return "\n".join(text.splitlines()[-lines:])

    def close(self) -> None:
        """Ends all processes, the last started first in line; waits until they are gone."""
        self._end(list(reversed(self._children.values())))

    def leftover_processes(self) -> int:
        """How many processes of this fleet still run, children of children included."""
        return len(_members(self._groups))

    def _spawn(
        self, command: Sequence[str], log: Path, json_lines: Path | None, nice: int
    ) -> subprocess.Popen[bytes]:
        one_thread = {
            f"{library}_NUM_THREADS": "1" for library in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")
        }
        with log.open("ab") as errors, (json_lines or log).open("ab") as output:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                env={**os.environ, **one_thread, "PYTHONUNBUFFERED": "1"},
                process_group=0,
                preexec_fn=_end_with(os.getpid(), nice),
            )
        self._groups.add(process.pid)
        return process

    def _end(self, children: Sequence[_Child]) -> None:
        groups = {child.process.pid for child in children}
        for child in children:
            child.told_to_end = True
        _signal_groups(groups, signal.SIGTERM)
        wait_until(lambda: _all_gone(children, groups), GRACE_S)
        _signal_groups(groups, signal.SIGKILL)
        for child in children:
            child.process.wait()
        wait_until(lambda: not _members(groups), GRACE_S)

    def _accepts(self) -> bool:
        import socket

        host, port = self.endpoint.removeprefix("tcp/").rsplit(":", 1)
        try:
            socket.create_connection((host, int(port)), timeout=0.2).close()
        except OSError:
            return False
        return True


def _leave(signum: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + signum)


def _end_with(parent: int, nice: int) -> Callable[[], None]:
    """For the child, between fork and exec: SIGTERM when the parent's main thread is gone."""

    def prepare() -> None:
        os.nice(nice)
        _libc.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # it ended before prctl could tell
            os._exit(1)

    return prepare


def _all_gone(children: Sequence[_Child], groups: set[int]) -> bool:
    for child in children:
        child.process.poll()  # reaps it, so that its group can be empty
    return not _members(groups)


def _members(groups: set[int]) -> list[int]:
    """Process ids in any of the groups, zombies left out."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                state, _, group = entry.joinpath("stat").read_text().rsplit(") ", 1)[1].split()[:3]
            except (OSError, IndexError):  # it ended while we looked
                continue
            if int(group) in groups and state != "Z":
                found.append(int(entry.name))
    return found


def _signal_groups(groups: set[int], signum: signal.Signals) -> None:
    for group in {os.getpgid(pid) for pid in _members(groups)} if groups else ():
        try:
            os.killpg(group, signum)
        except ProcessLookupError:
            continue  # the last one ended in the meantime


def wait_running(fleet: LocalFleet, condition: Callable[[], bool], timeout_s: float) -> bool:
    """Waits for a condition while all processes of the fleet run; whether it came true in time.

    Raises:
        ProcessEndedError: one of them ended.
    """
    end = time.monotonic() + timeout_s
    while not wait_until(condition, min(0.25, max(end - time.monotonic(), 0.0))):
        fleet.check()
        if time.monotonic() > end:
            return False
    return True
