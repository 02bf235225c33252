"""A link to a router that carries so many bytes a second from the robot, as a radio does."""

import socket
import threading
import time
from contextlib import suppress

_CHUNK = 4096


class SlowLink:
    """Passes connections on to a router; use it in a `with`.

    Args:
        router: its endpoint.
        bytes_s: what passes from the robot to the router; the way back is free.
    """

    def __init__(self, router: str, bytes_s: float) -> None:
        host, _, port = router.removeprefix("tcp/").rpartition(":")
        self._router, self._bytes_s = (host, int(port)), bytes_s
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._open: list[socket.socket] = [self._listener]
        self.endpoint = f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> "SlowLink":
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        for one in self._open:
            with suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
            one.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                robot, _ = self._listener.accept()
                router = socket.create_connection(self._router)
                self._open += [robot, router]
                for source, sink, rate in ((robot, router, self._bytes_s), (router, robot, None)):
                    threading.Thread(target=_pump, args=(source, sink, rate), daemon=True).start()


def _pump(source: socket.socket, sink: socket.socket, bytes_s: float | None) -> None:
    due_s = time.monotonic()
    with suppress(OSError):
        while data := source.recv(_CHUNK):
            sink.sendall(data)
            if bytes_s is not None:
                due_s = max(due_s, time.monotonic() - 0.1) + len(data) / bytes_s
                time.sleep(max(due_s - time.monotonic(), 0.0))
