"""A service as a process: signals end it, and so does an error in any of its threads."""

import signal
import threading
from collections.abc import Callable

from fleetpose.pose_server.app.service import Service


def serve(build: Callable[[], Service]) -> None:
    """Builds a service and runs it until SIGTERM or SIGINT; the session is closed whatever
    happens.

    An error in any thread that nobody expected ends the service: a crash must be seen as one.
    """
    service = build()
    failures: list[BaseException] = []

    def fail(failed: threading.ExceptHookArgs) -> None:
        threading.__excepthook__(failed)
        failures.append(failed.exc_value or RuntimeError("a thread ended"))
        service.stopped.set()

    threading.excepthook = fail
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: service.stopped.set())
    try:
        service.run()
    finally:
        service.close()
    if failures:
        raise failures[0]
