"""What readers warn of while something is looked at, to be printed as notes."""

import logging
from types import TracebackType
from typing import Self


class Told(logging.Handler):
    """Keeps the warnings of the project's readers, each once, while it is entered."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []

    def __enter__(self) -> Self:
        logging.getLogger("fleetpose").addHandler(self)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        logging.getLogger("fleetpose").removeHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        line = record.getMessage()
        if line not in self.lines:
            self.lines.append(line)
