"""A slow link between page and bridge: a relay that lets only so many bits a second through.

Playwright's own throttling does not reach websockets. All connections share the link, and each
direction has its own, as on a radio or a phone line.
"""

import asyncio
import contextlib
import threading
from typing import Self

_CHUNK = 2048
_BUFFER = 16_384  # what waits before the link, in bytes; more would be the relay's delay
_START_S = 5.0


class SlowLink:
    """Relays a port of its own to another one of this machine; use it in a `with`.

    The page's address names the relay; as the bridge refuses other addresses than its own, the
    names of the relay in requests are made the bridge's.

    Args:
        port: of the bridge.
        bits_per_s: in each direction.
    """

    def __init__(self, port: int, bits_per_s: float) -> None:
        self._to_port, self._bytes_per_s = port, bits_per_s / 8
        self._loop = asyncio.new_event_loop()
        self._free_at = {"up": 0.0, "down": 0.0}
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="slow link", daemon=True)
        self.port = 0

    def __enter__(self) -> Self:
        self._thread.start()
        if not self._ready.wait(_START_S):
            raise TimeoutError(f"the relay does not start within {_START_S:g} s")
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_START_S)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(
            asyncio.start_server(self._connected, "127.0.0.1", 0, limit=_BUFFER)
        )
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        self._loop.run_forever()
        server.close()
        for task in asyncio.all_tasks(self._loop):
            task.cancel()
        self._loop.run_until_complete(asyncio.sleep(0))
        self._loop.close()

    async def _connected(self, page: asyncio.StreamReader, to_page: asyncio.StreamWriter) -> None:
        opened = asyncio.open_connection("127.0.0.1", self._to_port, limit=_BUFFER)
        try:
            bridge, to_bridge = await opened
        except OSError:
            to_page.close()
            return
        await asyncio.gather(
            self._pass_on(page, to_bridge, "up"), self._pass_on(bridge, to_page, "down")
        )

    async def _pass_on(
        self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, way: str
    ) -> None:
        own, other = (f"127.0.0.1:{port}".encode() for port in (self.port, self._to_port))
        sink.transport.set_write_buffer_limits(_CHUNK)
        with contextlib.suppress(OSError):
            while chunk := await source.read(_CHUNK):
                await self._carried(len(chunk), way)
                sink.write(chunk.replace(own, other) if way == "up" else chunk)
                await sink.drain()
        sink.close()

    async def _carried(self, count: int, way: str) -> None:
        """Waits until the link has carried so many bytes behind all that it was given before."""
        now = self._loop.time()
        self._free_at[way] = max(self._free_at[way], now) + count / self._bytes_per_s
        await asyncio.sleep(self._free_at[way] - now)
