"""Opens sessions. A start is as patient as an outage: who waits says so and for what, and is
connected as soon as any of its routers is there.
"""

import errno
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import zenoh

from fleetpose.protocol.errors import EndedError, EndpointError, UnreachableError
from fleetpose.protocol.session import configuration
from fleetpose.protocol.session.configuration import Configuration
from fleetpose.protocol.text import without_source

log = logging.getLogger(__name__)

FOR_EVER = -1.0
_SAID_AGAIN_S = 60.0
_FIRST_PAUSE_S = 0.2
_LONGEST_PAUSE_S = 1.0


@dataclass(frozen=True)
class SessionSettings:
    """How to reach the router.

    Attributes:
        connect: endpoints of the router, e.g. `tcp/127.0.0.1:7447`; of several, the first that
            answers.
        listen: endpoints to listen on; with some, the session is itself a router.
        config_file: a zenoh configuration (JSON5) that replaces both, for TLS and access control.
        timeout_s: how long to wait for a router, which is asked at least once; negative waits for
            ever, and says so.
        stop: ends the waiting when it is set.
        waiting: is told, at each try, what is waited for.
    """

    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    config_file: Path | None = None
    timeout_s: float = 10.0
    stop: threading.Event | None = None
    waiting: Callable[[str], None] = lambda status: None

    def configuration(self) -> Configuration:
        """The zenoh configuration of it.

        Raises:
            EndpointError: an endpoint or the configuration file cannot be used.
        """
        if self.config_file is not None:
            return configuration.read(self.config_file)
        return configuration.written(self.connect, self.listen)


def open_session(settings: SessionSettings) -> zenoh.Session:
    """Opens a session: a client of a router, or a router where `listen` names endpoints.

    Raises:
        EndpointError: an endpoint or the configuration file is not as zenoh reads it, or an
            endpoint to listen on is taken.
        UnreachableError: no router answered in time.
        EndedError: the waiting was ended.
    """
    config = settings.configuration()
    if config.is_client:
        return _connected(config, settings)
    where = ", ".join(settings.listen) or str(settings.config_file)
    try:
        return zenoh.open(config.zenoh)
    except zenoh.ZError as error:
        raise EndpointError(f"no router can be at {where}: {_why_not_there(error)}") from error


def _why_not_there(error: zenoh.ZError) -> str:
    said = without_source(str(error))
    if f"os error {errno.EADDRINUSE})" in said:
        return "the address is in use by another program: end it, or take another port"
    if f"os error {errno.EADDRNOTAVAIL})" in said:
        return "this machine has no such address"
    return said


def _connected(config: Configuration, settings: SessionSettings) -> zenoh.Session:
    """Asks again and again; a round over all endpoints is one call of zenoh's."""
    where = ", ".join(config.endpoints) or str(settings.config_file)
    stop = settings.stop or threading.Event()
    began_s, pause_s, say_s = time.monotonic(), _FIRST_PAUSE_S, 0.0
    while not stop.is_set():
        try:
            session = zenoh.open(config.zenoh)
        except zenoh.ZError as error:
            waited_s = time.monotonic() - began_s
            if 0 <= settings.timeout_s <= waited_s:
                raise UnreachableError(_reason(where, config, error)) from error
            settings.waiting(f"waiting for a router at {where}")
            if settings.timeout_s < 0 and waited_s >= say_s:
                log.warning("%s; waiting for it", _reason(where, config, error))
                say_s = waited_s + _SAID_AGAIN_S
        else:
            if say_s:
                log.info("router reached after %.1f s", time.monotonic() - began_s)
            return session
        left_s = began_s + settings.timeout_s - time.monotonic()
        stop.wait(min(pause_s, max(left_s, 0.01)) if settings.timeout_s >= 0 else pause_s)
        pause_s = min(1.5 * pause_s, _LONGEST_PAUSE_S)
    raise EndedError(f"asked to end while waiting for a router at {where}")


def _reason(where: str, config: Configuration, error: zenoh.ZError) -> str:
    said = config.why_unreachable() or without_source(str(error))
    return f"no zenoh router at {where}: {said}"
