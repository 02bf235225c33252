"""One connection for the clients of several sites."""

import threading
from collections.abc import Callable

from fleetpose.protocol.transport import Link


class SharedLink:
    """Opens the connection with the first client and closes it with the last.

    Args:
        open_link: opens it.
    """

    def __init__(self, open_link: Callable[[], Link]) -> None:
        self._open_link = open_link
        self._lock = threading.Lock()
        self._link: Link | None = None
        self._users = 0

    def open(self) -> Link:
        """A client's own link over the connection; it waits while another client opens it.

        Raises:
            UnreachableError: there is no router.
        """
        with self._lock:
            if self._link is None:
                self._link = self._open_link()
            self._users += 1
            return _Part(self._link, self._leave)

    def _leave(self) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0 and self._link is not None:
                self._link.close()
                self._link = None


class _Part(Link):
    def __init__(self, whole: Link, leave: Callable[[], None]) -> None:
        super().__init__(whole.session)
        self._leave = leave

    def close(self) -> None:
        """Ends what was declared by this client alone."""
        for declared in self._declared:
            declared.undeclare()
        self._leave()
