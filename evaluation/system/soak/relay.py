"""A robot's link, which can be slowed or cut: TCP connections on loopback that are passed on to the
routers. What they carry is TLS and stays closed to it.
"""

import asyncio
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress

_BUFFER = 32 * 1024
"""Bytes that a socket of it keeps: what waits in a large one hides a slow link from who sends."""
_PART = 4096
_WITHIN_S = 10.0


class Relay:
    """Listens on a port of 127.0.0.1 for each router and passes on what comes, both ways.

    Args:
        routers: ports of 127.0.0.1 by the routers' names.

    Attributes:
        ports: where it listens, by the routers' names.
        bytes_per_s: of each connection, each way; None: as fast as it goes.
    """

    def __init__(self, routers: Mapping[str, int]) -> None:
        self.bytes_per_s: float | None = None
        self._open: set[asyncio.StreamWriter] = set()
        self._passing: set[asyncio.Task[None]] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay", daemon=True)
        self._thread.start()
        self._servers: list[asyncio.Server] = []
        self.ports = {name: self._listen(port) for name, port in routers.items()}

    @property
    def passing(self) -> int:
        """How many connections stand."""
        return len(self._passing)

    def cut(self) -> None:
        """Ends the connections that stand; new ones are passed on."""
        self._loop.call_soon_threadsafe(self._cut)

    def close(self) -> None:
        """Ends all connections and listens no more."""

        async def end() -> None:
            for server in self._servers:
                server.close()
            self._cut()
            await asyncio.wait_for(
                asyncio.gather(*self._passing, return_exceptions=True), _WITHIN_S
            )

        asyncio.run_coroutine_threadsafe(end(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _listen(self, router: int) -> int:
        listening = socket.socket()
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
        listening.bind(("127.0.0.1", 0))

        def accepted(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            task = self._loop.create_task(self._pass(reader, writer, router))
            self._passing.add(task)
            task.add_done_callback(self._passing.discard)

        serving = asyncio.start_server(accepted, sock=listening, limit=_BUFFER)
        self._servers.append(
            asyncio.run_coroutine_threadsafe(serving, self._loop).result(_WITHIN_S)
        )
        return listening.getsockname()[1]

    async def _pass(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, router: int
    ) -> None:
        """One connection, until either side ends it; a router that is down ends it at once."""
        with self._known(writer), suppress(OSError):
            from_router, to_router = await asyncio.open_connection(
                "127.0.0.1", router, limit=_BUFFER
            )
            with self._known(to_router):
                ways = ((reader, to_router), (from_router, writer))
                pumps = [self._loop.create_task(self._pump(*way)) for way in ways]
                try:
                    await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
                finally:
                    for pump in pumps:
                        pump.cancel()
                await asyncio.gather(*pumps, return_exceptions=True)

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(_PART):
            writer.write(data)
            await writer.drain()
            if self.bytes_per_s is not None:
                await asyncio.sleep(len(data) / self.bytes_per_s)

    @contextmanager
    def _known(self, writer: asyncio.StreamWriter) -> Iterator[None]:
        self._open.add(writer)
        try:
            yield
        finally:
            self._open.discard(writer)
            writer.close()

    def _cut(self) -> None:
        for writer in self._open:
            writer.transport.abort()
        for task in self._passing:  # one that holds back what came does not see the end of it
            task.cancel()
