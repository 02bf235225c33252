"""Between zenoh and the session: what arrives goes into the session, what was done goes out.

Callbacks open what came and store it. Three threads work: one reads, one sends
(`hmi_client.network.sender`), and one asks for views (`hmi_client.network.view_requests`).
"""

import logging
import threading
import time
from collections import deque
from collections.abc import Callable

from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.intake import Intake
from fleetpose.hmi_client.network.message_decoder import Arrived
from fleetpose.hmi_client.network.sender import Sender
from fleetpose.hmi_client.network.view_requests import Fetcher
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import FleetPoseError, UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import FleetState, View, ViewName
from fleetpose.protocol.presence import LiveServer
from fleetpose.protocol.transport import Link, Sample, Slots

log = logging.getLogger(__name__)

STATE_SHARE = 0.015  # of a core that opening the fleet's state may take: 4 ms each at 72 robots
HASTY_SHARE = 0.06  # while an image is shown only once the state says that the server has its view
LONGEST_PAUSE_S = 0.5  # between states, however long one took: maps and matrices are drawn at 2 Hz
MOST_WAITING = 8  # states: the server tells ten in a second; what more comes is opened at once
READ_S = 0.25


class Client:
    """Connects a session to the fleet; use it in a `with`, or `start` and `close` it.

    Args:
        session: where everything goes.
        keys: the keys of the site.
        open_link: opens the connection; it is retried when it fails in the background.
        each_pose: hear each pose as it is told; else the state, which tells the newest of all, is
            enough.
    """

    def __init__(
        self,
        session: OperatorSession,
        keys: Keys,
        open_link: Callable[[], Link],
        each_pose: bool = True,
    ) -> None:
        self.session = session
        self.keys = keys
        self.failure: Exception | None = None
        self._open_link = open_link
        self._each_pose = each_pose
        self._link: Link | None = None
        self._server: LiveServer | None = None
        self._intake = Intake(session, keys)
        self._inbox: Slots[Arrived] = Slots()
        self._stop = threading.Event()
        self._state_turn = threading.Lock()  # states are opened in the order in which they came
        self._state_opened_s, self._state_took_s = 0.0, 0.0
        self._waiting_states: deque[Sample] = deque()
        self._threads: list[threading.Thread] = []

    def start(self) -> None:
        """Connects and begins.

        Raises:
            UnreachableError: there is no router.
        """
        self._connect(self._open_link())

    def start_in_background(self) -> None:
        """Begins at once and connects as soon as there is a router."""
        self._run("hmi connect", self._connect_when_possible)

    def close(self) -> None:
        """Ends the threads and the connection."""
        self._stop.set()
        self._inbox.close()
        for thread in self._threads:
            thread.join(timeout=5.0)
        if self._link is not None:
            self._link.close()

    def __enter__(self) -> "Client":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        if self.failure is not None:
            raise self.failure

    @property
    def drops(self) -> Drops:
        """What arrived and could not be used, by reason."""
        return self.session.drops

    @property
    def replaced(self) -> int:
        """How many samples were overtaken by newer ones before they were read."""
        return self._inbox.replaced

    # ---- connecting ------------------------------------------------------------------------------

    def _run(self, name: str, target: Callable[[], None]) -> None:
        thread = threading.Thread(name=name, target=self._guarded, args=(target,), daemon=True)
        self._threads.append(thread)
        thread.start()

    def _guarded(self, target: Callable[[], None]) -> None:
        try:
            target()
        except Exception as error:  # a bug: whoever shows the session must end and tell it
            if not self._stop.is_set():
                log.exception("%s failed", threading.current_thread().name)
                self.failure = error

    def _connect_when_possible(self) -> None:
        while not self._stop.is_set():
            try:
                link = self._open_link()
            except UnreachableError as error:
                log.info("%s", error)
                self._stop.wait(0.5)
                continue
            if self._stop.is_set():
                link.close()
            else:
                self._connect(link)
            return

    def _connect(self, link: Link) -> None:
        self._link, self._server = link, LiveServer(link, self.keys)
        operator = self.session.operator
        for key in (
            self.keys.state,
            self.keys.status,
            *((self.keys.poses,) if self._each_pose else ()),
            self.keys.correspondences("*", "*"),
            *((self.keys.receipts(operator),) if self.session.acts else ()),
            self.keys.selection("*"),
            self.keys.camera("*"),
            self.keys.alignment("*", "*"),
        ):
            link.on_latched(key, self._arrived)
        sender = Sender(self.session, self.keys, link, self._arrived)
        self._run("hmi read", self._read)
        self._run("hmi send", lambda: sender.run(self._stop))
        fetcher = Fetcher(self.session, self.keys, link)
        self._run("hmi fetch", lambda: fetcher.run(self._stop))

    # ---- reading ---------------------------------------------------------------------------------

    def _arrived(self, sample: Sample) -> None:
        """Opens what came, in the subscriber's thread: so nothing damaged takes the place of
        something good that waits to be read. Nor does what another process says for the server.
        """
        if sample.key == self.keys.state:
            with self._state_turn:
                self._take_due_states()  # before a newer one takes their place
                share = HASTY_SHARE if self.session.pictures_wait else STATE_SHARE
                if self._is_early(share) and len(self._waiting_states) < MOST_WAITING:
                    self._waiting_states.append(sample)
                else:
                    self._take(sample)
        else:
            self._take(sample)

    def _take(self, sample: Sample) -> None:
        self._survive(sample.key, lambda: self._inbox.store(self._opened(sample)))

    def _take_due_states(self) -> None:
        """Opens the newest good one of the states that came since the last, once that has cost no
        more than its share. Newer ones, which are damaged, count; older ones are passed over.
        """
        while self._waiting_states and not self._is_early():
            self._take(self._waiting_states.pop())

    def _is_early(self, share: float = STATE_SHARE) -> bool:
        """Whether a state would take more of the core than its share."""
        pause_s = min(self._state_took_s / share, LONGEST_PAUSE_S)
        return time.monotonic() < self._state_opened_s + pause_s

    def _opened(self, sample: Sample) -> Arrived:
        began_s = time.thread_time()  # a busy machine is no reason to look less often
        arrived = self._intake.open(sample)
        epoch = getattr(arrived.content, "server_epoch", None)
        if epoch is not None and self._server is not None:
            self._server.check(epoch, f"a {type(arrived.content).__name__}")
        if isinstance(arrived.content, FleetState):  # a good one: those before it are old
            self._waiting_states.clear()
            self._state_opened_s = time.monotonic()
            self._state_took_s = time.thread_time() - began_s
        return arrived

    def _read(self) -> None:
        while not self._stop.is_set():
            arrived = self._inbox.take(READ_S)
            if arrived is not None:
                self._survive(arrived.key, lambda one=arrived: self._intake.tell(one.content))
            with self._state_turn:
                self._take_due_states()

    def _survive(self, key: str, work: Callable[[], None]) -> None:
        try:
            work()
        except FleetPoseError as error:
            self.session.drop(key, error)

    # ---- asking for views ------------------------------------------------------------------------

    def fetch_picture(self, view: ViewName) -> Picture:
        """Asks for the image of a view; see `Fetcher.picture`.

        Raises:
            UnreachableError: nobody answers, or nobody has it any more.
            PictureError: what was answered is no image of it.
        """
        return self._fetcher().picture(view)

    def fetch_view(self, view: ViewName) -> View:
        """Asks for a view without its image; see `Fetcher.view`.

        Raises:
            UnreachableError: nobody answers, or nobody has it any more.
        """
        return self._fetcher().view(view)

    def _fetcher(self) -> Fetcher:
        if self._link is None:
            raise UnreachableError("not connected to a router yet")
        return Fetcher(self.session, self.keys, self._link)
