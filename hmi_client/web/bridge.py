"""One page: what it says goes to its operator's desk, what the desk shows goes to the page.

A page gets the newest of everything and nothing in between; the next image goes out once it has
drawn the last. So a slow link shows less often, never late.
"""

import asyncio
import contextlib
import json
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping

import anyio
import anyio.to_thread
from starlette.websockets import WebSocket, WebSocketDisconnect

from fleetpose.hmi_client.web import frames, outlook, told
from fleetpose.hmi_client.web.desk_link import DeskLink
from fleetpose.hmi_client.web.gate import Allowance
from fleetpose.hmi_client.web.heard import Heard, MalformedError, parse

log = logging.getLogger(__name__)

MALFORMED, DENIED_TOKEN, TOO_MANY = 4400, 4401, 4429  # codes that a connection is closed with
COMMANDS_PER_S = 200
MALFORMED_IN_A_ROW = 16


class Page:
    """A page that has said who it is.

    Args:
        socket: accepted.
        link: the desk of its operator.
        counts: of all pages, by what happened.
    """

    def __init__(self, socket: WebSocket, link: DeskLink, counts: Counter[str]) -> None:
        self.images, self.matrix, self.clouds = True, True, False
        self._socket, self._link, self._counts = socket, link, counts
        self._loop, self._woken = asyncio.get_running_loop(), asyncio.Event()
        self._own: list[str] = []
        self._sent: dict[str, int] = {}
        self._sent_clouds: dict[str, tuple[int, int, int]] = {}
        self._sent_images: list[tuple[object, int] | None] = [None, None]
        self._unseen: list[int | None] = [None, None]
        self._sent_s, self._thrift = [0.0, 0.0], outlook.Thrift()
        self._event = 0

    # ---- for the desk, from any thread -----------------------------------------------------------

    def wake(self) -> None:
        """There is something new to be sent."""
        with contextlib.suppress(RuntimeError):  # the loop has ended, and the page with it
            self._loop.call_soon_threadsafe(self._woken.set)

    def tell(self, frame: told.Frame) -> None:
        """Sends a frame to this page alone."""
        text = told.text_of(frame)
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._tell_soon, text)

    def _tell_soon(self, text: str) -> None:
        self._own.append(text)
        self._woken.set()

    # ---- the page's life -------------------------------------------------------------------------

    async def run(self) -> None:
        """Serves the page until it goes."""
        self._own.append(told.text_of(self._link.welcome()))
        self._link.join(self)
        self._woken.set()
        try:
            async with anyio.create_task_group() as both:

                async def until_gone(work: Callable[[], Awaitable[None]]) -> None:
                    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                        await work()
                    both.cancel_scope.cancel()

                both.start_soon(until_gone, self._send_for_ever)
                both.start_soon(until_gone, self._hear_for_ever)
        finally:
            self._link.leave(self)

    # ---- hearing ---------------------------------------------------------------------------------

    async def _hear_for_ever(self) -> None:
        allowance, in_a_row = Allowance(COMMANDS_PER_S), 0
        while True:
            text = await received(self._socket)
            if not allowance.take():
                self._counts["too many commands"] += 1
                await self._socket.close(TOO_MANY, f"more than {COMMANDS_PER_S} commands a second")
                return
            try:
                self._hear(parse(text))
                in_a_row = 0
            except MalformedError as error:
                in_a_row += 1
                self._counts["malformed"] += 1
                if in_a_row >= MALFORMED_IN_A_ROW:
                    await self._socket.close(MALFORMED, f"{in_a_row} malformed frames in a row")
                    return
                n = self._counts["malformed"]
                self._tell_soon(told.text_of(told.notice(f"{error} (malformed frame {n})")))

    def _hear(self, heard: Heard) -> None:
        args = heard.args
        match heard.do:
            case "ping":
                self._tell_soon(json.dumps({"t": "pong", "at": args.get("at", 0)}))
            case "ack":
                self._drawn(args)
            case "want":
                self.images = args.get("images", self.images)
                self.matrix = args.get("matrix", self.matrix)
                self.clouds = args.get("clouds", self.clouds)
                self._woken.set()
            case "hello":
                raise MalformedError("hello was said before")
            case _:
                self._link.do(self, heard)

    def _drawn(self, args: Mapping[str, int]) -> None:
        side, view = args.get("side"), args.get("view")
        if side is not None and self._unseen[side] == view:
            self._unseen[side] = None
            self._thrift.drawn(time.monotonic() - self._sent_s[side])
            self._woken.set()

    # ---- sending ---------------------------------------------------------------------------------

    async def _send_for_ever(self) -> None:
        while True:
            await self._woken.wait()
            self._woken.clear()
            own, self._own = self._own, []
            for text in own:
                await self._socket.send_text(text)
            await self._send_events()
            for name in outlook.ORDER:
                await self._send(name)
            if self.images:
                for side in (0, 1):
                    await self._send_image(side)
            if self.matrix:
                for name in outlook.FLEET:
                    await self._send(name)
            if self.clouds:
                await self._send_cloud()

    async def _send(self, name: str) -> None:
        fresh = self._link.outlook.since(name, self._sent.get(name, 0))
        if fresh is None:
            return
        self._sent[name], frame = fresh
        if isinstance(frame, bytes):
            await self._socket.send_bytes(frame)
        else:
            await self._socket.send_text(frame)

    async def _send_events(self) -> None:
        for n, text in self._link.events:
            if n > self._event:
                self._event = n
                await self._socket.send_text(text)

    async def _send_image(self, side: int) -> None:
        shown, sent = self._link.pictures.shown[side], self._sent_images[side]
        if shown is None or sent == (shown.pair, shown.id):
            return
        if self._unseen[side] is not None and sent is not None and sent[0] == shown.pair:
            return
        if not self._thrift.known and self._unseen[1 - side] is not None:
            return
        self._sent_images[side] = shown.pair, shown.id
        self._unseen[side] = shown.id
        self._link.pictures.keep(shown)
        picture, quality = shown.picture, self._thrift.quality
        if quality < 100:
            picture = await anyio.to_thread.run_sync(outlook.compressed, picture, quality)
        self._sent_s[side] = time.monotonic()
        await self._socket.send_bytes(frames.image(side, shown.id, picture))

    async def _send_cloud(self) -> None:
        """The points of one robot; those of the next follow when what is more urgent is out."""
        names = self._link.outlook.value("names") or {}
        order = self._link.outlook.version("names")
        clouds = self._link.cloud_of
        for index, robot in enumerate(names.get("names", ())):
            cloud, sent = clouds.get(robot), self._sent_clouds.get(robot, (0, 0, 0))
            if cloud is None or sent == (order, cloud.keyframe, cloud.version):
                continue
            same = sent[:2] == (order, cloud.keyframe)
            self._sent_clouds[robot] = order, cloud.keyframe, cloud.version
            points = cloud.pose_alone if same else cloud.points
            frame = frames.cloud(index, cloud.keyframe, cloud.T_fleet_robot, points)
            await self._socket.send_bytes(frame)
            self._woken.set()
            return


async def received(socket: WebSocket) -> str:
    """The next text of a page; bytes are none.

    Raises:
        WebSocketDisconnect: the page has gone.
    """
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    return message.get("text") or ""
