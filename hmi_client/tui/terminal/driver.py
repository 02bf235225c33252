"""The terminal's driver, made for slow lines."""

from typing import Any

from textual.drivers.linux_driver import LinuxDriver

from fleetpose.hmi_client.tui.terminal.terminal_diff import TerminalDiff


class PatientDriver(LinuxDriver):
    """Textual's driver for Linux and macOS: what it has written waits in a queue, and it writes
    only what the terminal does not show yet.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._frugal = TerminalDiff()

    @property
    def behind(self) -> bool:
        """Whether something still waits: painting more would only make it later."""
        writer = self._writer_thread
        return writer is not None and not writer._queue.empty()

    def write(self, data: str) -> None:
        super().write(self._frugal.rewritten(data))

    def forget(self) -> None:
        """The terminal may show anything now: the next writes are whole."""
        self._frugal.forget()
