"""What systemd wants to hear of a service (`Type=notify`): ready, alive, how it is.

Elsewhere nothing happens.
See sd_notify(3): datagrams to the socket that the environment names.
"""

import os
import socket
import time

_LEAST_PAUSE_S = 1.0


class Supervisor:
    """Tells systemd how this process is. `alive` may be called as often as one likes."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        mine = os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        self._watched = mine and "WATCHDOG_USEC" in os.environ
        self._told, self._told_s = "", 0.0

    def ready(self) -> None:
        """It has started; what it still waits for is in its status."""
        self._send("READY=1")

    def alive(self, status: str = "") -> None:
        """It goes on, and how it is; told once a second at most."""
        now_s = time.monotonic()
        if now_s - self._told_s < _LEAST_PAUSE_S:
            return
        self._told_s = now_s
        lines = ["WATCHDOG=1"] * self._watched + [f"STATUS={status}"] * (status != self._told)
        self._told = status
        self._send(*lines)

    def stopping(self) -> None:
        """It ends."""
        self._send("STOPPING=1")

    def _send(self, *lines: str) -> None:
        if not (self._address and lines):
            return
        address = "\0" + self._address[1:] if self._address[0] == "@" else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
            systemd.connect(address)
            systemd.sendall("\n".join(lines).encode())
