"""`hmi-client web` as a process: desks of operators, and a server for their pages."""

import gc
import logging
import signal
import threading
import webbrowser
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import uvicorn

from fleetpose.hmi_client.cli.connection import Connection
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.desk.keymap import KeyMap
from fleetpose.hmi_client.local_files import own_updates, state_folder
from fleetpose.hmi_client.network.shared import SharedLink
from fleetpose.hmi_client.web.app import make_app
from fleetpose.hmi_client.web.desk_link import DeskLink
from fleetpose.hmi_client.web.gate import Address, Gate, check_reach, own_token, read_tokens
from fleetpose.hmi_client.web.heard import LONGEST
from fleetpose.hmi_client.web.page_settings import PageSettings
from fleetpose.hmi_client.web.seats import LiveSeat, PlayedSeat

log = logging.getLogger(__name__)
RETRY_TIMEOUT_S = 2.0  # per attempt to reach the router; pages are served meanwhile


@dataclass(frozen=True)
class Reach:
    """Where pages are served and to whom.

    Attributes:
        listen: the address.
        token_file: lines `kim:TOKEN`; none: one token for this user's own pages.
        certificate, key: PEM files for TLS.
        names: more names under which pages reach it.
        open_browser: shows the page at once.
    """

    listen: Address
    token_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    names: tuple[str, ...] = ()
    open_browser: bool = False

    def check(self) -> None:
        """Refuses what would let in others.

        Raises:
            OperatorError: see `gate.check_reach`.
        """
        check_reach(self.listen, self.token_file, self.certificate, self.key)

    def tokens(self, operator: str) -> dict[str, str]:
        """The operator of each token; without a file one for this operator."""
        if self.token_file is not None:
            return read_tokens(self.token_file)
        return {own_token(state_folder() / "web-token"): operator}


class Desks:
    """The desk of every operator who has come, made when he first comes.

    Args:
        make: makes one for an operator.
    """

    def __init__(self, make: Callable[[str], DeskLink]) -> None:
        self._make, self._lock = make, threading.Lock()
        self._links: dict[str, DeskLink] = {}

    def link_of(self, operator: str) -> DeskLink:
        """The desk of an operator."""
        with self._lock:
            if operator not in self._links:
                self._links[operator] = self._make(operator)
            return self._links[operator]

    def close(self) -> None:
        """Ends all of them."""
        for link in self._links.values():
            link.close()


def live_desks(
    where: Connection,
    keymap: KeyMap,
    threshold_m: float | None,
    on_failure: Callable[[Exception], None],
) -> Desks:
    """Desks at a site; they share one connection to the router and wait for it.

    Args:
        where: the site, by its router.
        keymap: the keys of the commands.
        threshold_m: errors above it are hidden; default: a share of the scene's depth.
        on_failure: called with a bug that ended the work.
    """
    shared = SharedLink(lambda: where.open_link(RETRY_TIMEOUT_S))
    address = str(where.config or ", ".join(where.connect))

    def make(operator: str) -> DeskLink:
        mine = replace(where, operator=operator)
        kept = own_updates(mine)
        session = mine.session(threshold_m, kept)
        client = mine.client(session, RETRY_TIMEOUT_S, each_pose=False, shared=shared)
        desk = Desk(session, keymap.names(), f"of {mine.site} at {address}")
        settings = PageSettings(state_folder() / f"web-{mine.site}-{operator}.json")
        seat = LiveSeat(desk, client, kept)
        return DeskLink(seat, mine.site, address, keymap, settings, on_failure)

    return Desks(make)


def played_desks(
    file: Path, keymap: KeyMap, on_failure: Callable[[Exception], None]
) -> tuple[Desks, str]:
    """One desk over a recording, and the operator's name.

    Raises:
        FleetPoseError: the file cannot be read, or is no recording of a session.
    """
    seat = PlayedSeat(file, lambda session: Desk(session, keymap.names()))
    site, operator = seat.name
    settings = PageSettings(state_folder() / "web-replay.json")
    link = DeskLink(seat, site, str(file), keymap, settings, on_failure)
    return Desks(lambda _: link), operator


class Served:
    """Pages that are served until `stop`, or until a bug ends it.

    Args:
        reach: where and to whom; its port may be 0 for any.
        tokens: the operator of each token.
    """

    def __init__(self, reach: Reach, tokens: dict[str, str]) -> None:
        self.counts: Counter[str] = Counter()
        self.failure: Exception | None = None
        self._socket = reach.listen.open()
        self._reach = replace(
            reach, listen=Address(reach.listen.host, self._socket.getsockname()[1])
        )
        self.gate = Gate.at(
            self._reach.listen, tokens, self._reach.certificate is not None, reach.names
        )
        self._server: uvicorn.Server | None = None

    @property
    def url(self) -> str:
        """The address of the pages."""
        return f"{'https' if self.gate.secure else 'http'}://{self._reach.listen.shown}/"

    @property
    def started(self) -> bool:
        """Whether pages can come."""
        return self._server is not None and self._server.started

    def fail(self, error: Exception) -> None:
        """Ends the serving because of a bug."""
        self.failure = self.failure or error
        self.stop()

    def stop(self) -> None:
        """Ends the serving."""
        if self._server is not None:
            self._server.should_exit = True

    def run(self, desks: Desks, ready: Callable[[], None] = lambda: None) -> None:
        """Serves until told to stop, or by SIGINT or SIGTERM.

        Args:
            desks: of the operators.
            ready: called once pages can come.
        """
        config = uvicorn.Config(
            make_app(self.gate, desks.link_of, self.counts),
            log_config=None,
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=LONGEST,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
            ssl_certfile=self._reach.certificate,
            ssl_keyfile=None if self._reach.key is None else str(self._reach.key),
        )
        self._server = uvicorn.Server(config)
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, signal.default_int_handler)  # uvicorn ends, then we do
        try:
            ready()
            self._server.run(sockets=[self._socket])
        except KeyboardInterrupt:
            pass
        finally:
            self._socket.close()
            desks.close()
        if self.counts:
            log.info("pages: %s", ", ".join(f"{what} {n}" for what, n in self.counts.items()))
        if self.failure is not None:
            raise self.failure


def run_web(
    where: Connection,
    reach: Reach,
    keymap: KeyMap,
    threshold_m: float | None = None,
    replay: Path | None = None,
    say: Callable[[str], None] = print,
) -> None:
    """Serves pages until it is interrupted.

    Args:
        where: the site; pages come up also without its router, and wait.
        reach: where pages are served and to whom.
        keymap: the keys of the commands.
        threshold_m: errors above it are hidden; default: a share of the scene's depth.
        replay: a recorded session that is shown in place of the site's.
        say: prints the address.

    Raises:
        FleetPoseError: an option is not right, or the port is taken.
    """
    reach.check()
    cv2.setNumThreads(1)  # what an image shows is worked out beside the hand, not in its place
    served = Served(reach, reach.tokens(where.operator))
    if replay is not None:
        desks, _ = played_desks(replay, keymap, served.fail)
    else:
        desks = live_desks(where, keymap, threshold_m, served.fail)
        if reach.token_file is None:
            desks.link_of(where.operator)  # goes on with what was kept, also before a page comes
    token = next(iter(served.gate.tokens)) if reach.token_file is None else ""
    url = f"{served.url}#token={token}" if token else f"{served.url}#token=TOKEN"

    def ready() -> None:
        gc.freeze()  # what is here stays: going through it again and again stops all for 40 ms
        say(url)
        if reach.open_browser and token:
            threading.Thread(target=webbrowser.open, args=(url,), daemon=True).start()

    served.run(desks, ready)
