"""The terminal's driver, which can tell that the terminal is slow."""

from textual.drivers.linux_driver import LinuxDriver


class PatientDriver(LinuxDriver):
    """Textual's driver for Linux and macOS: what it has written waits in a queue."""

    @property
    def behind(self) -> bool:
        """Whether something still waits: painting more would only make it later."""
        writer = self._writer_thread
        return writer is not None and not writer._queue.empty()
