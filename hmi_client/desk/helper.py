"""Work that would hold a hand up is done beside it, in a thread."""

import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

T = TypeVar("T")
BESIDE = 10  # by which the thread is nicer than what answers a hand


class Helper:
    """One thread; of each kind of work only the newest counts.

    Args:
        ready: called, in that thread, when something is done.
    """

    def __init__(self, ready: Callable[[], None] = lambda: None) -> None:
        self.ready = ready
        self._pool: ThreadPoolExecutor | None = None
        self._asked: dict[str, tuple[Future[Any], Callable[[Any], None]]] = {}

    def ask(self, what: str, work: Callable[[], T], take: Callable[[T], None]) -> None:
        """Begins with a work; what was asked before under the same name is not taken any more."""
        self.forget(what)
        if self._pool is None:
            self._pool = ThreadPoolExecutor(1, "hmi helper", _step_back)
        future = self._pool.submit(work)
        self._asked[what] = future, take
        future.add_done_callback(lambda _: self.ready())

    def forget(self, what: str) -> None:
        """Does not wait for a work any more."""
        if what in self._asked:
            self._asked.pop(what)[0].cancel()

    def take(self) -> None:
        """Hands over what is done.

        Raises:
            Exception: whatever a work has raised.
        """
        done = [(what, *asked) for what, asked in self._asked.items() if asked[0].done()]
        for what, future, take in done:
            del self._asked[what]
            take(future.result())

    def settle(self, timeout_s: float) -> None:
        """Waits for what has been asked."""
        wait([future for future, _ in self._asked.values()], timeout_s)

    def close(self) -> None:
        """Ends the thread; what it is at is not taken."""
        self._asked.clear()
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
            self._pool = None


def _step_back() -> None:
    """Lets what answers a hand go first: on Linux threads have priorities of their own."""
    if sys.platform == "linux":
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), BESIDE)
