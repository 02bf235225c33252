"""Views asked of their robots: those that an operator looks at and the server never got, the images
of those that were clicked in, and the newest of a robot that was there before the server.
"""

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from fleetpose.pose_server.state.views import open_view
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import KeptView, ViewName
from fleetpose.protocol.transport import Sample

log = logging.getLogger(__name__)

TIMEOUT_S = 2.0
WIDE_TIMEOUT_S = 10.0  # robots make wide sets when asked, one after the other
_AT_ONCE = 4  # a robot that does not answer must not hold up the others
_MOST_WAITING = 200


@dataclass(frozen=True)
class Fetched:
    """What became of a request: the view with its image, or why there is none."""

    name: ViewName
    kept: KeptView | None
    reason: str = ""


@dataclass(frozen=True)
class FetchedWide:
    """A view with its wide set of salient points, encoded; none where the robot has none."""

    name: ViewName
    payload: bytes | None


@dataclass(frozen=True)
class FetchedNewest:
    """The newest view of a robot, which was asked for because none had come."""

    kept: KeptView


class Fetcher:
    """Asks robots for views, a few at a time and each view once at a time.

    Args:
        keys: of the site.
        query: asks one selector with a timeout in seconds; raises a FleetPoseError.
        store: takes each `Fetched`, `FetchedNewest` and `FetchedWide`, in another thread.
        drops: where answers that are no views are counted.
    """

    def __init__(
        self,
        keys: Keys,
        query: Callable[[str, float], Sample],
        store: Callable[[Fetched | FetchedNewest | FetchedWide], None],
        drops: Drops | None = None,
    ) -> None:
        self._keys, self._query, self._store = keys, query, store
        self._drops = Drops() if drops is None else drops
        self._asked: set[ViewName] = set()
        self._asked_newest: set[str] = set()
        self._pool = ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="fetch")

    def ask(self, name: ViewName) -> bool:
        """Asks for a view unless it is asked for already; whether an answer will come."""
        if name not in self._asked:
            if len(self._asked) >= _MOST_WAITING:
                return False
            self._asked.add(name)
            self._pool.submit(self._fetch, name)
        return True

    def ask_newest(self, robot: str) -> None:
        """Asks a robot for its newest view; nothing is stored where it has none."""
        if robot not in self._asked_newest and len(self._asked_newest) < _MOST_WAITING:
            self._asked_newest.add(robot)
            self._pool.submit(self._fetch_newest, robot)

    def ask_wide(self, name: ViewName) -> None:
        """Asks a robot for the wide set of a view."""
        self._pool.submit(self._fetch_wide, name)

    def close(self) -> None:
        """Drops what waits; what is asked now ends within its timeout."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _fetch(self, name: ViewName) -> None:
        try:
            fetched = Fetched(name, self._answer(name.robot, f"?seq={name.seq};epoch={name.epoch}"))
            if fetched.kept is not None and fetched.kept.view.name != name:
                raise CodecError(f"another view than asked: {fetched.kept.view.name} for {name}")
        except FleetPoseError as error:
            if isinstance(error, CodecError):
                self._drops.note(self._keys.view(name.robot), error)
            log.info("view not fetched name=%s reason=%s", name, error)
            fetched = Fetched(name, None, str(error))
        self._asked.discard(name)
        self._store(fetched)

    def _fetch_newest(self, robot: str) -> None:
        try:
            kept = self._answer(robot)
        except FleetPoseError as error:
            if isinstance(error, CodecError):
                self._drops.note(self._keys.view(robot), error)
            log.info("no newest view of robot=%s reason=%s", robot, error)
        else:
            self._store(FetchedNewest(kept))
        finally:
            self._asked_newest.discard(robot)

    def _fetch_wide(self, name: ViewName) -> None:
        payload = None
        which = f"?seq={name.seq};epoch={name.epoch};salient=wide"
        try:
            kept = self._answer(name.robot, which, WIDE_TIMEOUT_S)
            if kept.view.name != name:
                raise CodecError(f"another view than asked: {kept.view.name} for {name}")
            payload = open_view(pack(kept.view), None, 0.0).payload
        except FleetPoseError as error:
            if isinstance(error, CodecError):
                self._drops.note(self._keys.view(name.robot), error)
            log.info("no wide set name=%s reason=%s", name, error)
        self._store(FetchedWide(name, payload))

    def _answer(self, robot: str, which: str = "", timeout_s: float = TIMEOUT_S) -> KeptView:
        """What a robot has, its newest view where none is named."""
        answer = self._query(self._keys.view(robot) + which, timeout_s)
        kept = unpack(KeptView, answer.payload, answer.encoding)
        if kept.view.name.robot != robot:
            raise CodecError(f"a view of another robot than asked: {kept.view.name}")
        return kept
