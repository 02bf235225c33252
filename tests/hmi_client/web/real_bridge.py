"""The real bridge in a thread of this process, for tests of it and of the page.

    with real_bridge(router, folder) as served:      # `served.url`, `served.token`
        ...

`served.page()` is a page that says hello and keeps what it hears.
"""

import contextlib
import json
import os
import ssl
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from fleetpose.hmi_client.cli.connection import Connection
from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.web.gate import Address
from fleetpose.hmi_client.web.serve import Reach, Served, live_desks, played_desks


class PageOfTest:
    """Hears in a thread; `texts` is the newest frame of each kind, `heard` all of them."""

    def __init__(self, socket: ClientConnection, token: str, acks: bool = True) -> None:
        self._socket, self._acks = socket, acks
        self.texts: dict[str, dict[str, Any]] = {}
        self.heard: list[dict[str, Any]] = []
        self.binaries: dict[tuple[int, int], bytes] = {}
        self.images: list[tuple[int, int]] = []
        self.code: int | None = None
        self._changed = threading.Condition()
        self.say(do="hello", token=token, v=1)
        threading.Thread(target=self._hear, daemon=True).start()

    def say(self, **message: Any) -> None:
        self._socket.send(json.dumps(message))

    def say_raw(self, text: str | bytes) -> None:
        self._socket.send(text)

    def wait(self, condition, timeout_s: float = 5.0) -> None:
        """Until it holds for this page."""
        with self._changed:
            met = self._changed.wait_for(lambda: condition(self), timeout_s)
        assert met, f"did not come true; heard {sorted(self.texts)}, closed {self.code}"

    def image(self, side: int) -> int:
        """The number of the newest image of a side."""
        return struct.unpack_from("<BBHI", self.binaries[1, side])[3]

    def close(self) -> None:
        self._socket.close()

    def _hear(self) -> None:
        with contextlib.suppress(Exception):
            for frame in self._socket:
                with self._changed:
                    self._take(frame)
                    self._changed.notify_all()
        with self._changed:
            self.code = self._socket.close_code
            self._changed.notify_all()

    def _take(self, frame: str | bytes) -> None:
        if isinstance(frame, str):
            told = json.loads(frame)
            self.texts[told["t"]] = told
            self.heard.append(told)
            return
        kind, side, n, id = struct.unpack_from("<BBHI", frame)
        self.binaries[kind, n if kind == 4 else side] = frame
        if kind == 1:
            self.images.append((side, id))
            if self._acks:
                self.say(do="ack", side=side, view=id)


class RealBridge:
    """What `real_bridge` gives."""

    def __init__(self, served: Served, tokens: dict[str, str]) -> None:
        self.served, self.tokens = served, tokens
        self.url, self.token = served.url, next(iter(tokens))
        self.pages: list[PageOfTest] = []
        self._opened = contextlib.ExitStack()

    def close(self) -> None:
        """Closes all pages."""
        self._opened.close()

    def page(self, token: str | None = None, acks: bool = True, **options: Any) -> PageOfTest:
        scheme, _, rest = self.url.partition("://")
        wss = "wss" if scheme == "https" else "ws"
        origin = options.pop("origin", self.url.rstrip("/"))
        opening = connect(f"{wss}://{rest}ws", origin=origin, compression=None, **options)
        socket = self._opened.enter_context(opening)
        self.pages.append(PageOfTest(socket, self.token if token is None else token, acks))
        return self.pages[-1]


@contextlib.contextmanager
def real_bridge(
    endpoint: str,
    folder: Path,
    tokens: dict[str, str] | None = None,
    listen: str = "127.0.0.1:0",
    replay: Path | None = None,
    **reach: Any,
) -> Iterator[RealBridge]:
    """Serves pages of the site `demo` behind a router; what it keeps lies in `folder`."""
    os.environ["XDG_STATE_HOME"] = str(folder)
    tokens = tokens or {"let-me-in-please": "kim"}
    where = Connection((endpoint,), "demo", None, next(iter(tokens.values())))
    served = Served(Reach(Address.of(listen), **reach), tokens)
    if replay is None:
        desks = live_desks(where, KeyMap(), None, served.fail)
    else:
        desks, _ = played_desks(replay, KeyMap(), served.fail)
    failed: list[BaseException] = []

    def run() -> None:
        try:
            served.run(desks)
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    end = time.monotonic() + 5
    while not served.started and time.monotonic() < end:
        time.sleep(0.01)
    bridge = RealBridge(served, tokens)
    try:
        yield bridge
    finally:
        bridge.close()
        served.stop()
        thread.join(10)
        assert not failed, failed


def insecure() -> ssl.SSLContext:
    """For pages of tests that come by TLS with a certificate that nobody has signed."""
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    return context
