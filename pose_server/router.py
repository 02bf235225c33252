"""A zenoh router as a process of its own: used as soon as a second process or machine joins."""

import signal
import threading

from protocol.transport import run_router


def route(endpoint: str) -> None:
    """Routes until SIGTERM or SIGINT."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    print(f"router on {endpoint}", flush=True)
    run_router(endpoint, stop)
