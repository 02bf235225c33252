"""A browser without a screen, what it costs, and what went wrong in its pages."""

import contextlib
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import psutil

from fleetpose.protocol.errors import FleetPoseError

MISSING_PLAYWRIGHT = "pose-eval web drives a browser: pip install playwright"
MISSING_CHROMIUM = "pose-eval web needs the browser chromium: apt-get install chromium"
SIZE = (1600, 1000)
_NAMES = ("chromium", "chromium-browser", "google-chrome")
_CONNECTED = "() => document.querySelector('#link span')?.textContent.startsWith('Live')"
_CONNECTED_WITHIN_S = 20.0
_POLL_MS = 10


class NoBrowserError(FleetPoseError):
    """Chromium or playwright is not installed; says how to install it."""


@dataclass
class Wrongs:
    """What a page did that no page may: errors on its console, requests to other origins."""

    console: list[str] = field(default_factory=list)
    foreign: list[str] = field(default_factory=list)


def chromium() -> Path:
    """The browser.

    Raises:
        NoBrowserError: it or playwright is not installed.
    """
    try:
        import playwright.sync_api  # noqa: F401
    except ImportError as error:
        raise NoBrowserError(MISSING_PLAYWRIGHT) from error
    found = next(filter(None, map(shutil.which, _NAMES)), None)
    if found is None:
        raise NoBrowserError(MISSING_CHROMIUM)
    return Path(found)


class Browser:
    """Chromium without a screen; use it in a `with`.

    Args:
        arguments: more of them for Chromium.

    Raises:
        NoBrowserError: it or playwright is not installed.
    """

    def __init__(self, *arguments: str) -> None:
        self._path, self._arguments = chromium(), arguments
        self._wrongs: dict[Any, Wrongs] = {}
        self._cpu_s: dict[tuple[int, float], float] = {}

    def __enter__(self) -> Self:
        from playwright.sync_api import sync_playwright

        self._open = contextlib.ExitStack()
        playwright = self._open.enter_context(sync_playwright())
        before = _processes()
        self.chromium = playwright.chromium.launch(
            executable_path=self._path, args=["--no-sandbox", "--disable-gpu", *self._arguments]
        )
        self._open.callback(self.chromium.close)
        self._root = _outermost(_processes() - before)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def page(
        self,
        address: str,
        size: tuple[int, int] = SIZE,
        dpr: float = 1.0,
        touch: bool = False,
        wait: bool = True,
        before: Callable[[Any], None] = lambda _: None,
    ) -> Any:
        """A page of a context of its own, once it says that it is connected.

        Args:
            address: with the token.
            size: CSS pixels.
            dpr: pixels of the screen per CSS pixel.
            touch: whether it has fingers.
            wait: whether to wait until it is connected.
            before: called with the page before it loads anything.

        Raises:
            FleetPoseError: it is not, within 20 s.
        """
        viewport: Any = {"width": size[0], "height": size[1]}
        context = self.chromium.new_context(
            viewport=viewport, device_scale_factor=dpr, has_touch=touch
        )
        page = context.new_page()
        self._record(page, address)
        before(page)
        page.goto(address)
        if wait and not became(page, _CONNECTED, timeout_s=_CONNECTED_WITHIN_S):
            said = page.inner_text("#link")
            raise FleetPoseError(f"the page does not connect; it says {said!r}")
        return page

    def wrongs(self, page: Any) -> Wrongs:
        """What went wrong in a page since it was opened."""
        return self._wrongs[page]

    def cpu_s(self) -> float:
        """CPU time of all processes of the browser, also of those that have ended."""
        for process in self._members():
            with contextlib.suppress(psutil.Error):
                times = process.cpu_times()
                who = process.pid, process.create_time()
                self._cpu_s[who] = times.user + times.system
        return sum(self._cpu_s.values())

    def renderer_rss(self) -> int:
        """Bytes of memory of all renderers."""
        total = 0
        for process in self._members():
            with contextlib.suppress(psutil.Error):
                if "--type=renderer" in process.cmdline():
                    total += process.memory_info().rss
        return total

    def _members(self) -> list[psutil.Process]:
        with contextlib.suppress(psutil.Error):
            return [self._root, *self._root.children(recursive=True)]
        return []

    def _record(self, page: Any, address: str) -> None:
        wrongs = self._wrongs[page] = Wrongs()
        origin = address.partition("#")[0]
        own = (origin, origin.replace("http", "ws", 1), f"blob:{origin}", "data:")

        def asked(url: str) -> None:
            if not url.startswith(own):
                wrongs.foreign.append(url)

        page.on("console", lambda m: wrongs.console.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: wrongs.console.append(str(error)))
        page.on("request", lambda request: asked(request.url))
        page.on("websocket", lambda socket: asked(socket.url))


def became(page: Any, condition: str, arg: Any = None, timeout_s: float = 15.0) -> bool:
    """Whether a function of JavaScript gives something true in a page in time. It is asked from
    here: playwright's own wait evaluates texts within the page, which its policy forbids.
    """
    end = time.monotonic() + timeout_s
    while not page.evaluate(condition, arg):
        if time.monotonic() > end:
            return False
        page.wait_for_timeout(_POLL_MS)
    return True


def _processes() -> set[psutil.Process]:
    return set(psutil.Process().children(recursive=True))


def _outermost(found: set[psutil.Process]) -> psutil.Process:
    """The process whose parent is none of them: the browser itself."""
    ids = {process.pid for process in found}
    roots = [process for process in found if process.ppid() not in ids]
    if not roots:
        raise FleetPoseError("the browser's processes are not to be found in /proc")
    return min(roots, key=lambda process: process.create_time())
