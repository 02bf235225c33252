"""The log of every process: a record is one line, UTC, level, logger, event and `key=value`.

Texts from elsewhere cannot forge a line; a traceback alone has several.
"""

import logging
import logging.handlers
import time
from pathlib import Path

from fleetpose.protocol.text import one_line

MAX_FILE_BYTES = 10_000_000  # then the file is begun anew, and the one before is kept


class OneLine(logging.Formatter):
    """`2026-11-24T20:13:04.036Z INFO pose_server update operator=anna n=7 accepted`."""

    converter = time.gmtime

    def __init__(self) -> None:
        fields = "%(asctime)s.%(msecs)03dZ %(levelname)s %(name)s %(message)s"
        super().__init__(fields, "%Y-%m-%dT%H:%M:%S")

    def formatMessage(self, record: logging.LogRecord) -> str:
        record.message = one_line(record.message)
        return super().formatMessage(record)


def log_to_stderr(level: int = logging.INFO) -> None:
    """For processes that a supervisor runs: it keeps what they write."""
    _log_to(logging.StreamHandler(), level)


def log_to_file(path: Path, level: int = logging.INFO) -> None:
    """For a process that draws on the terminal.

    Raises:
        OSError: the file or its folder cannot be made.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rotating = logging.handlers.RotatingFileHandler(path, maxBytes=MAX_FILE_BYTES, backupCount=1)
    _log_to(rotating, level)


def _log_to(handler: logging.Handler, level: int) -> None:
    handler.setFormatter(OneLine())
    logging.basicConfig(level=level, handlers=[handler], force=True)
