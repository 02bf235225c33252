"""zenoh's log as lines: what this process writes to its standard output goes through a pipe that a
thread reads.
"""

import logging
import os
import re
import threading
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import zenoh

from fleetpose.pose_server.routing.denials import MODULE
from fleetpose.protocol.text import one_line, without_source

log = logging.getLogger("zenoh")

_CHUNK = 1 << 20
_MOST_LINES_S = 20_000  # that are read: beyond, zenoh must not wait for who reads its log
_MOST_PASSED_ON_S = 10.0
_COLOURS = re.compile(r"\x1b\[[0-9;]*m")
_HEAD = re.compile(r"^\S+Z +(?:TRACE|DEBUG|INFO|WARN|ERROR)[^:]*? (?=\w+(?:::|:))")


class ZenohLog:
    """Starts zenoh's log, at warnings and above and with what its rules decide; use it in a `with`
    around the session. `RUST_LOG` may ask for more.

    Args:
        take: is given each line; whether that was all it is good for. Others are logged.

    Attributes:
        unread: lines that came too fast.
    """

    def __init__(self, take: Callable[[str], bool]) -> None:
        self._take = take
        self.unread = 0
        self._passed_on = _MOST_PASSED_ON_S
        self._passed_s = time.monotonic()

    def __enter__(self) -> Self:
        asked = os.environ.get("RUST_LOG", "warn")
        os.environ["RUST_LOG"] = f"{asked},{MODULE}=trace"
        reader, writer = os.pipe()
        self._real = os.dup(1)
        os.dup2(writer, 1)
        os.close(writer)
        self._thread = threading.Thread(target=self._read, args=(reader,), daemon=True)
        self._thread.start()
        zenoh.init_log_from_env_or("warn")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        os.dup2(self._real, 1)  # closes the pipe's last writer: the thread ends
        self._thread.join(1.0)

    def _read(self, reader: int) -> None:
        rest, budget, begun_s = b"", _MOST_LINES_S, time.monotonic()
        with os.fdopen(reader, "rb", buffering=0) as pipe:
            while chunk := pipe.read(_CHUNK):
                *lines, rest = (rest + chunk).split(b"\n")
                if time.monotonic() - begun_s > 1.0:
                    budget, begun_s = _MOST_LINES_S, time.monotonic()
                for line in lines[:budget]:
                    self._line(_COLOURS.sub("", line.decode(errors="replace")))
                self.unread += max(len(lines) - budget, 0)
                budget = max(budget - len(lines), 0)

    def _line(self, line: str) -> None:
        if self._take(line) or not line.strip():
            return
        now_s = time.monotonic()
        more = (now_s - self._passed_s) * _MOST_PASSED_ON_S
        self._passed_on, self._passed_s = min(self._passed_on + more, _MOST_PASSED_ON_S), now_s
        if self._passed_on >= 1.0:
            self._passed_on -= 1.0
            log.warning("%s", one_line(without_source(_HEAD.sub("", line)), 500))
