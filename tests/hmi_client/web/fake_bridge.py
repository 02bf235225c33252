"""A bridge without a client: serves the page, says what a test wants, keeps what it hears."""

import asyncio
import contextlib
import json
import socket
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path

import scenes
import uvicorn
from scenes import Frame
from starlette.applications import Starlette
from starlette.responses import FileResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

STATIC = Path(__file__).parents[3] / "hmi_client" / "web" / "static"
CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "font-src 'self'; connect-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)


class FakeBridge:
    """`scene` is what a page hears after its hello; `heard` is what pages said."""

    def __init__(self) -> None:
        self.scene: list[Frame] = []
        self.settings: dict = {}
        self.heard: list[dict] = []
        self.silent = False
        self.refuse = False
        self._sockets: set[WebSocket] = set()
        routes = [
            Route("/", self._index),
            Mount("/static", StaticFiles(directory=STATIC)),
            WebSocketRoute("/ws", self._page),
        ]
        self._server = uvicorn.Server(uvicorn.Config(Starlette(routes=routes), log_level="error"))

    @contextlib.contextmanager
    def serving(self) -> Iterator[str]:
        """The address to open, while it serves."""
        with socket.create_server(("127.0.0.1", 0)) as listening:
            thread = threading.Thread(target=self._server.run, args=([listening],), daemon=True)
            thread.start()
            _until(lambda: self._server.started)
            self._loop = self._server.servers[0].get_loop()
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
            self.drop()
            self._server.should_exit = True
            thread.join(5)

    def show(self, scene: list[Frame], settings: dict | None = None) -> None:
        """What the next page sees."""
        self.scene, self.settings, self.heard = scene, settings or {}, []
        self.silent = self.refuse = False

    def say(self, *frames: Frame) -> None:
        """To all pages, now."""
        for frame in frames:
            self._to_all(lambda page, frame=frame: _send(page, frame))

    def drop(self) -> None:
        """Closes all connections, as a bridge that ends does."""
        self._to_all(lambda page: page.close())

    def wait_for(self, do: str, timeout_s: float = 10.0) -> dict:
        """The newest command of that id."""
        _until(lambda: any(m["do"] == do for m in self.heard), timeout_s)
        return next(m for m in reversed(self.heard) if m["do"] == do)

    def _to_all(self, job: Callable[[WebSocket], Awaitable[None]]) -> None:
        async def all_of_them() -> None:
            await asyncio.gather(*map(job, self._sockets), return_exceptions=True)

        asyncio.run_coroutine_threadsafe(all_of_them(), self._loop).result(10)

    async def _index(self, _) -> FileResponse:
        return FileResponse(STATIC / "index.html", headers={"Content-Security-Policy": CSP})

    async def _page(self, page: WebSocket) -> None:
        await page.accept()
        hello = await page.receive_json()
        if hello != {"do": "hello", "token": "let-me-in", "v": 1} or self.refuse:
            await page.close(4401)
            return
        self._sockets.add(page)  # before any await: what is not refused can be dropped
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            for frame in (scenes.welcome(self.settings), *self.scene):
                await _send(page, frame)
            while True:
                await self._answer(page, await page.receive_json())
        self._sockets.discard(page)

    async def _answer(self, page: WebSocket, message: dict) -> None:
        if message["do"] == "ping":
            if not self.silent:
                await page.send_json({"t": "pong", "at": message["at"]})
        else:
            self.heard.append(message)


async def _send(page: WebSocket, frame: Frame) -> None:
    if isinstance(frame, bytes):
        await page.send_bytes(frame)
    else:
        await page.send_text(json.dumps(frame))


def _until(done, timeout_s: float = 10.0) -> None:
    end = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > end:
            raise TimeoutError(f"not within {timeout_s} s")
        time.sleep(0.005)
