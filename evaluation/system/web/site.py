"""A site to hold the page to its bars: a router, a stand-in for server and robots that speaks at
known rates, and `hmi-client web`, all of them real processes on loopback.
"""

import json
import os
import secrets
import shutil
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any, Self

import psutil

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import free_port

OPERATORS = ("kim", "ana", "bo", "cy")
"""Who may come; the first is meant where none is named."""
BRIDGE, STAND_IN = "bridge", "stand-in"
_UP_WITHIN_S = 20.0
_STATE_HOME = "XDG_STATE_HOME"


class WebSite:
    """Starts router, stand-in and `hmi-client web`; use it in a `with`, in the main thread.

    Args:
        robots: in the fleet.
        rate_hz: of all poses and errors.
        out: folder for logs, notes and what the bridge keeps; emptied before.
        image_hz: of each image that is wanted.
        points: correspondences that the stand-in has for a pair whose images are held.
        questions: that are asked, two at most.

    Raises:
        FleetPoseError: on entering, a process does not start.
    """

    server = STAND_IN  # the process that is silenced

    def __init__(
        self,
        robots: int = 72,
        rate_hz: float = 10.0,
        out: Path = Path("out"),
        image_hz: float = 5.0,
        points: int = 0,
        questions: int = 2,
    ) -> None:
        self.robots, self.out = robots, out
        self._told = {
            "--robots": robots,
            "--rate": rate_hz,
            "--image-rate": image_hz,
            "--points": points,
            "--questions": questions,
        }
        self._notes = out / "updates.jsonl"
        self._port = free_port()
        self._tokens = {name: secrets.token_hex(16) for name in OPERATORS}
        self._used_s = 0.0  # by bridges that were killed

    def __enter__(self) -> Self:
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir(parents=True)
        self._outer_state = os.environ.get(_STATE_HOME)
        os.environ[_STATE_HOME] = str(self.out / "state")
        self.fleet = LocalFleet(self.out / "logs").__enter__()
        try:
            self._start()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *raised: Any) -> None:
        self.silence_server(False)
        self.fleet.__exit__(*raised)
        if self._outer_state is None:
            os.environ.pop(_STATE_HOME, None)
        else:
            os.environ[_STATE_HOME] = self._outer_state

    # ---- what a bar does to it -------------------------------------------------------------------

    @property
    def port(self) -> int:
        """Where the bridge listens, also after it was started anew."""
        return self._port

    def address(self, operator: str | None = None, port: int | None = None) -> str:
        """The page's address with the token of an operator.

        Args:
            operator: one of `OPERATORS`.
            port: of something that stands between page and bridge; default: the bridge's own.
        """
        token = self._tokens[operator or OPERATORS[0]]
        return f"http://127.0.0.1:{port or self._port}/#token={token}"

    def kill_bridge(self) -> None:
        """SIGKILL, as a crash would end it."""
        self._used_s = self.bridge_cpu_s()
        self.fleet.kill(BRIDGE)

    def start_bridge(self) -> None:
        """Starts it again, on the same port and with what it had kept; returns once it listens.

        Raises:
            FleetPoseError: it does not, within 20 s.
        """
        self.fleet.restart(BRIDGE)
        self._wait_listening()

    def silence_server(self, silent: bool) -> None:
        """Freezes the stand-in, or lets it go on."""
        if self.server in self.fleet.names():
            self.fleet.signal(self.server, "SIGSTOP" if silent else "SIGCONT")

    # ---- what came of it -------------------------------------------------------------------------

    def bridge_cpu_s(self) -> float:
        """CPU time of all bridges so far."""
        times = psutil.Process(self.fleet.pid(BRIDGE)).cpu_times()
        return self._used_s + times.user + times.system

    def bridge_rss(self) -> int:
        """Bytes of memory that the bridge holds."""
        return psutil.Process(self.fleet.pid(BRIDGE)).memory_info().rss

    def received(self) -> list[dict[str, Any]]:
        """The updates that the stand-in's server has confirmed, in order: `operator`, `session`,
        `n`, `action`, `i`, `j`, `pixel_i`, `pixel_j`. Clicks that were lost or doubled can be
        counted by their pixels.
        """
        if not self._notes.exists():
            return []
        whole, _, _ = self._notes.read_text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()]

    # ---- starting --------------------------------------------------------------------------------

    def _start(self) -> None:
        self.start_server()
        self._serve()

    def start_server(self) -> None:
        """Starts what stands behind the bridge: a router and the stand-in."""
        self.fleet.start_router()
        told = [text for name, value in self._told.items() for text in (name, str(value))]
        notes = ("--notes", str(self._notes))
        where = self.fleet.connection
        self.fleet.start(STAND_IN, "fleetpose.evaluation", STAND_IN, *where, *told, *notes)

    def _serve(self) -> None:
        tokens = self.out / "tokens"
        tokens.touch(mode=0o600)
        tokens.write_text("".join(f"{name}:{token}\n" for name, token in self._tokens.items()))
        served = ("--listen", f"127.0.0.1:{self._port}", "--token-file", str(tokens), "--no-open")
        log = ("--log", str(self.out / "logs" / "hmi-client.log"))
        where = self.fleet.connection
        self.fleet.start(BRIDGE, "fleetpose.hmi_client", "web", *where, *served, *log)
        self._wait_listening()

    def _wait_listening(self) -> None:
        if not wait_running(self.fleet, self._listens, _UP_WITHIN_S):
            raise FleetPoseError(
                f"after {_UP_WITHIN_S:.0f} s hmi-client web serves nothing on port {self._port}; "
                f"the logs are in {self.fleet.directory}"
            )

    def _listens(self) -> bool:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{self._port}/", timeout=0.5) as answer:
                return answer.status == 200
        except (urllib.error.URLError, OSError):
            return False
