"""What the text client costs: it runs in a pseudo-terminal that is read as fast as it writes."""

import contextlib
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import psutil

from fleetpose.protocol.errors import FleetPoseError

_ESCAPES = re.compile(rb"\x1b(?:\[[0-?]*[ -/]*[@-~]|\][^\x07]*\x07|[()].)")
_CHUNK = 1 << 16
_TAIL = 4096  # bytes that are looked at again with those that follow: a text may come in two parts


@dataclass
class Metered:
    """A program in a pseudo-terminal; use it in a `with`.

    Attributes:
        bytes_out: what it has written.
        text: its last output without escape sequences.
    """

    command: Sequence[str]
    columns: int = 160
    rows: int = 50
    environment: Mapping[str, str] = field(default_factory=dict)
    bytes_out: int = 0
    _tail: bytes = b""

    def __enter__(self) -> Self:
        self._master, slave = pty.openpty()
        size = struct.pack("HHHH", self.rows, self.columns, 0, 0)
        fcntl.ioctl(slave, termios.TIOCSWINSZ, size)
        self._process = subprocess.Popen(
            self.command,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            env={**os.environ, "TERM": "xterm-256color", "COLORTERM": "truecolor"}
            | dict(self.environment),
            start_new_session=True,
        )
        os.close(slave)
        self._watched = psutil.Process(self._process.pid)
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._drain_until_gone()
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        os.close(self._master)

    @property
    def cpu_s(self) -> float:
        """CPU time it has used."""
        times = self._watched.cpu_times()
        return times.user + times.system

    @property
    def rss_mb(self) -> float:
        """Memory it holds."""
        return self._watched.memory_info().rss / 1e6

    def press(self, keys: bytes) -> None:
        """Types bytes."""
        os.write(self._master, keys)

    def read_until(self, text: str | None, timeout_s: float) -> float | None:
        """Reads what is written, until a text is in it (with None for the whole time).

        Returns:
            Seconds until the text came, None if it did not.
        """
        began_s = time.monotonic()
        wanted = None if text is None else text.encode()
        self._tail = b""
        while (left_s := began_s + timeout_s - time.monotonic()) > 0:
            ready, _, _ = select.select([self._master], [], [], left_s)
            if not ready:
                break
            try:
                chunk = os.read(self._master, _CHUNK)
            except OSError as error:
                raise FleetPoseError("the client ended while it was measured") from error
            at_s = time.monotonic() - began_s
            self.bytes_out += len(chunk)
            seen = self._tail + chunk
            if wanted is not None and wanted in _ESCAPES.sub(b"", seen):
                return at_s
            self._tail = seen[-_TAIL:]
        return None

    def _drain_until_gone(self) -> None:
        for _ in range(100):
            if self._process.poll() is not None:
                return
            ready, _, _ = select.select([self._master], [], [], 0.05)
            if ready:
                with contextlib.suppress(OSError):
                    os.read(self._master, _CHUNK)
