"""Between zenoh and the session: what arrives goes into the session, what was done goes out.

Callbacks only store. Three threads work: one reads, one sends (`hmi_client.sender`), and one asks
robots for views whose picture does not come by itself.
"""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable

from hmi_client.model import Pair, Picture
from hmi_client.sender import Sender
from hmi_client.session import OperatorSession
from protocol.codec import MAX_MESSAGE_BYTES, unpack
from protocol.errors import CodecError, FleetPoseError, UnreachableError
from protocol.keys import Keys
from protocol.messages import (
    Alignment,
    FleetState,
    ImageHeader,
    KeptView,
    PairCorrespondences,
    Receipts,
    RobotPose,
    ServerStatus,
    ViewName,
)
from protocol.transport import ENCODING_JPEG, Link, Sample, Slots

log = logging.getLogger(__name__)
PATIENCE_S = 0.6  # without a live picture for this long, the robot is asked for its newest view
RETRY_S = 2.0


class Client:
    """Connects a session to the fleet; use it in a `with`, or `start` and `close` it.

    Args:
        session: where everything goes.
        keys: the keys of the site.
        open_link: opens the connection; it is retried when it fails in the background.
    """

    def __init__(self, session: OperatorSession, keys: Keys, open_link: Callable[[], Link]) -> None:
        self.session = session
        self.keys = keys
        self.drops: Counter[str] = Counter()
        self.failure: Exception | None = None
        self._open_link = open_link
        self._link: Link | None = None
        self._inbox = Slots()
        self._alignments: dict[str, Sample] = {}
        self._stop = threading.Event()
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
        self._link = link
        operator = self.session.operator
        for key in (
            self.keys.state,
            self.keys.status,
            self.keys.poses,
            self.keys.correspondences("*", "*"),
            self.keys.receipts(operator),
        ):
            link.on_latched(key, self._inbox.store)
        link.on_latched(self.keys.alignment("*", "*"), self._keep_alignment)
        sender = Sender(self.session, self.keys, link, self._inbox, self._recall_alignment)
        self._run("hmi read", self._read)
        self._run("hmi send", lambda: sender.run(self._stop))
        self._run("hmi fetch", self._fetch)

    # ---- reading ---------------------------------------------------------------------------------

    def _keep_alignment(self, sample: Sample) -> None:
        """Alignments of 72 robots are many: only those of the selected pair are decoded."""
        self._alignments[sample.key] = sample
        if self.session.pair and sample.key == self.keys.alignment(*self.session.pair):
            self._inbox.store(sample)

    def _read(self) -> None:
        while not self._stop.is_set():
            sample = self._inbox.take(0.5)
            if sample is not None:
                self._survive(sample.key, lambda sample=sample: self._take(sample))

    def _survive(self, key: str, work: Callable[[], None]) -> None:
        try:
            work()
        except FleetPoseError as error:
            self.drops[type(error).__name__] += 1
            log.warning("dropped %s: %s", key, error)

    def _take(self, sample: Sample) -> None:
        session = self.session
        match self.keys.chunks(sample.key):
            case ["fleet", "state"]:
                session.on_fleet(unpack(FleetState, sample.payload, sample.encoding))
            case ["server", "status"]:
                session.on_status(unpack(ServerStatus, sample.payload, sample.encoding))
            case ["pose", _]:
                session.on_pose(unpack(RobotPose, sample.payload, sample.encoding))
            case ["pair", _, _, "alignment"]:
                session.on_alignment(unpack(Alignment, sample.payload, sample.encoding))
            case ["pair", _, _, "correspondences"]:
                known = unpack(PairCorrespondences, sample.payload, sample.encoding)
                session.on_correspondences(known)
            case ["operator", _, "receipts"]:
                session.on_receipts(unpack(Receipts, sample.payload, sample.encoding))
            case ["robot", robot, "image"]:
                session.on_picture(self._picture(robot, sample))
            case _:
                raise CodecError("nothing is expected under this key")

    def _picture(self, robot: str, sample: Sample) -> Picture:
        if sample.encoding != ENCODING_JPEG or sample.attachment is None:
            raise CodecError(f"no JPEG with its header, but '{sample.encoding[:80]}'")
        if len(sample.payload) > MAX_MESSAGE_BYTES:
            raise CodecError(f"a JPEG of {len(sample.payload)} bytes")
        header = unpack(ImageHeader, sample.attachment)
        if header.view.robot != robot:
            raise CodecError(f"an image of {header.view.robot} under the key of {robot}")
        return Picture(header.view, sample.payload, header.scale, self.session.clock())

    # ---- asking for views ------------------------------------------------------------------------

    def _fetch(self) -> None:
        next_try: dict[str, float] = {}
        while not self._stop.wait(0.1):
            if self.session.pair is None or self.session.seconds_selected < PATIENCE_S:
                continue
            for robot in self.session.pair:
                now = time.monotonic()
                if self.session.picture(robot) is None and now > next_try.get(robot, 0.0):
                    next_try[robot] = now + RETRY_S
                    self._survive(robot, lambda robot=robot: self._fetch_newest(robot))

    def _fetch_newest(self, robot: str) -> None:
        view = self.session.robot(robot).newest_view
        if view is not None:
            self.session.on_picture(self.fetch_picture(view))

    def fetch_picture(self, view: ViewName) -> Picture:
        """Asks a robot for the JPEG of one of its last views.

        Raises:
            UnreachableError: the robot does not answer, or no longer has it.
        """
        if self._link is None:
            raise UnreachableError("not connected to a router yet")
        selector = f"{self.keys.view(view.robot)}?seq={view.seq};epoch={view.epoch}"
        kept = unpack(KeptView, self._link.query(selector).payload)
        if kept.jpeg is None or kept.view.name != view:
            raise UnreachableError(f"{view.robot} has no image of its view {view.seq}")
        scale = kept.image.scale if kept.image else 1
        return Picture(view, kept.jpeg, scale, self.session.clock())

    def _recall_alignment(self, pair: Pair) -> None:
        """Feeds the alignment that came before its pair was selected."""
        sample = self._alignments.get(self.keys.alignment(*pair))
        if sample is not None:
            self._inbox.store(sample)
