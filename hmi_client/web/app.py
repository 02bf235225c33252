"""The routes: the page, its files, and the websocket behind it; and who may reach them."""

import asyncio
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from fleetpose.hmi_client.web.bridge import DENIED_TOKEN, MALFORMED, TOO_MANY, Page, received
from fleetpose.hmi_client.web.desk_link import DeskLink
from fleetpose.hmi_client.web.gate import Gate
from fleetpose.hmi_client.web.heard import MalformedError, parse

STATIC = Path(__file__).parent / "static"
VERSION = 1  # of the frames between page and bridge
MOST_PAGES = 16
HELLO_S = 5.0
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "img-src 'self' blob:; font-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


class Guard:
    """Refuses what was not meant for this address or comes from a page of another one, and says in
    every answer what a browser may do with it.
    """

    def __init__(self, app: ASGIApp, gate: Gate, counts: Counter[str]) -> None:
        self._app, self._gate, self._counts = app, gate, counts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self._refusal(scope)
        if refusal and scope["type"] == "websocket":
            self._counts["refused"] += 1
            await WebSocket(scope, receive, send).close(4403, refusal)  # is answered with 403
        elif refusal:
            self._counts["refused"] += 1
            await PlainTextResponse(refusal, 403, HEADERS)(scope, receive, send)
        else:
            await self._app(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> str:
        headers = Headers(scope=scope)
        if not self._gate.admits_host(headers.get("host", "")):
            return "this address is not served here: open the one that hmi-client web has printed"
        origin = headers.get("origin")
        needed = scope["type"] == "websocket"
        if (needed or origin is not None) and not self._gate.admits_origin(origin or ""):
            return "a page of another address may not come in"
        return ""


def _with_headers(send: Send) -> Send:
    async def send_with(message: Message) -> None:
        if message["type"] == "http.response.start":
            MutableHeaders(scope=message).update(HEADERS)
        await send(message)

    return send_with


class Pages:
    """All pages that are open.

    Args:
        gate: knows the tokens.
        link_of: the desk of an operator; it may take a moment.
        counts: of what was refused.
    """

    def __init__(
        self, gate: Gate, link_of: Callable[[str], DeskLink], counts: Counter[str]
    ) -> None:
        self._gate, self._link_of, self.counts = gate, link_of, counts
        self._open: set[WebSocket] = set()

    async def serve(self, socket: WebSocket) -> None:
        """Serves a page from its first word to its last."""
        await socket.accept()
        if len(self._open) >= MOST_PAGES:
            self.counts["too many pages"] += 1
            await socket.close(TOO_MANY, f"{MOST_PAGES} pages are open; close one")
            return
        self._open.add(socket)
        try:
            operator = await self._greeted(socket)
            if operator is not None:
                link = await run_in_threadpool(self._link_of, operator)
                await Page(socket, link, self.counts).run()
        except WebSocketDisconnect:
            pass
        finally:
            self._open.discard(socket)

    async def _greeted(self, socket: WebSocket) -> str | None:
        """Who the page says it is, by its token; none after it was sent away."""
        try:
            hello = parse(await asyncio.wait_for(received(socket), HELLO_S))
        except (MalformedError, TimeoutError):
            hello = None
        if hello is not None and hello.do == "hello" and hello.args.get("v") != VERSION:
            await socket.close(MALFORMED, "the page is of another version: load it again")
            return None
        told = hello.args.get("token") if hello is not None and hello.do == "hello" else None
        operator = self._gate.operator_of(told)
        if operator is None:
            self.counts["token refused"] += 1
            await socket.close(DENIED_TOKEN, "no such token")
        return operator


def make_app(
    gate: Gate, link_of: Callable[[str], DeskLink], counts: Counter[str] | None = None
) -> Starlette:
    """The application that a server serves.

    Args:
        gate: who is let in.
        link_of: the desk of an operator.
        counts: where refusals are counted.
    """
    counts = Counter() if counts is None else counts
    routes = [
        Route("/", _index),
        Mount("/static", StaticFiles(directory=STATIC, check_dir=False)),
        WebSocketRoute("/ws", Pages(gate, link_of, counts).serve),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Guard, gate=gate, counts=counts)])


async def _index(_: Request) -> FileResponse:
    return FileResponse(STATIC / "index.html")
