"""What the operator's clients keep on this machine: keys, updates on their way, a log."""

import logging
import os
from pathlib import Path
from typing import TYPE_CHECKING

from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.network.update_log import UpdateLog
from fleetpose.protocol.keys import checked_name
from fleetpose.protocol.logs import log_to_file

if TYPE_CHECKING:
    from fleetpose.hmi_client.cli.connection import Connection

log = logging.getLogger(__name__)


def state_folder() -> Path:
    """Where the client keeps what outlives it."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "fleetpose"


def default_log() -> Path:
    """The log file in the user's state folder."""
    return state_folder() / "hmi-client.log"


def own_log(path: Path) -> None:
    """Sends all logging to a file: anything on stderr would be drawn over the screen.

    Raises:
        OperatorError: the file cannot be written.
    """
    try:
        log_to_file(path)
    except OSError as error:
        raise OperatorError(f"log file {path} cannot be written: {error.strerror}") from error


def own_updates(where: "Connection") -> UpdateLog | None:
    """The operator's file of updates on their way, None while another client has it, and of who
    only looks.
    """
    if where.looks_only:
        return None
    name = f"updates-{checked_name(where.site)}-{checked_name(where.operator)}.sqlite"
    try:
        return UpdateLog(state_folder() / name)
    except OperatorError as error:
        log.warning("clicks on their way do not outlive a crash: %s", error)
        return None


def keymap_of(path: Path | None) -> KeyMap:
    """The keys by a file, or by that in the user's config folder if there is one.

    Raises:
        OperatorError: the file is not right.
    """
    config = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    usual = Path(config) / "fleetpose" / "keys.toml"
    if path is None and not usual.exists():
        return KeyMap()
    return KeyMap.read(path or usual)
