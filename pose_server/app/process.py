"""A service as a process: signals end it, and so does an error in any of its threads."""

import logging
import signal
import threading
from collections.abc import Callable

from fleetpose.pose_server.app.service import Service
from fleetpose.protocol.errors import EndedError

log = logging.getLogger("pose_server")


def serve(build: Callable[[threading.Event], Service]) -> None:
    """Builds a service and runs it until SIGTERM or SIGINT; the session is closed whatever
    happens.

    An error in any thread that nobody expected ends the service: a crash must be seen as one.

    Args:
        build: makes the service; the event that it is given is set when the process is to end.
    """
    stopped = threading.Event()
    failures: list[BaseException] = []

    def fail(failed: threading.ExceptHookArgs) -> None:
        threading.__excepthook__(failed)
        failures.append(failed.exc_value or RuntimeError("a thread ended"))
        stopped.set()

    threading.excepthook = fail
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopped.set())
    try:
        service = build(stopped)
    except EndedError as error:
        log.info("%s", error)
        return
    try:
        service.run()
    finally:
        service.close()
    if failures:
        raise failures[0]
