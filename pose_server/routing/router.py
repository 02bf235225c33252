"""A zenoh router as a process of its own: used as soon as a second process or machine joins."""

import signal
import threading
from pathlib import Path

from fleetpose.protocol.transport import SessionSettings, run_router


def route(listen: tuple[str, ...], config: Path | None) -> None:
    """Routes until SIGTERM or SIGINT; a zenoh configuration replaces the endpoints."""
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    print(f"router on {config or ', '.join(listen)}", flush=True)
    run_router(SessionSettings(listen=listen, config_file=config), stop)
