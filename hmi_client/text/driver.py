"""The terminal's driver, made for slow lines."""

from textual.drivers.linux_driver import LinuxDriver

from hmi_client.text.frugal import frugal


class PatientDriver(LinuxDriver):
    """Textual's driver for Linux and macOS: what it has written waits in a queue."""

    @property
    def behind(self) -> bool:
        """Whether something still waits: painting more would only make it later."""
        writer = self._writer_thread
        return writer is not None and not writer._queue.empty()

    def write(self, data: str) -> None:
        """Writes with no more colour codes than it takes."""
        super().write(frugal(data))
