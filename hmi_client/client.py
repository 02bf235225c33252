"""Between zenoh and the session: what arrives goes into the session, what was done goes out.

Callbacks only store. Three threads work: one reads, one sends (`hmi_client.sender`), and one asks
robots for views whose picture does not come by itself.
"""

import logging
import threading
import time
from collections.abc import Callable

from hmi_client.drops import Drops
from hmi_client.errors import PictureError
from hmi_client.jpeg import check_size, frame_of
from hmi_client.model import Pair, Picture
from hmi_client.sender import Sender
from hmi_client.session import OperatorSession
from protocol.codec import MAX_MESSAGE_BYTES, unpack
from protocol.errors import CodecError, FleetPoseError, UnreachableError
from protocol.keys import Keys
from protocol.messages import (
    Alignment,
    Camera,
    CameraAnnouncement,
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
        self.failure: Exception | None = None
        self._open_link = open_link
        self._link: Link | None = None
        self._inbox = Slots()
        self._alignments: dict[str, Sample] = {}
        self._cameras: dict[str, CameraAnnouncement] = {}
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
        self._link = link
        operator = self.session.operator
        for key in (
            self.keys.state,
            self.keys.status,
            self.keys.poses,
            self.keys.correspondences("*", "*"),
            self.keys.receipts(operator),
            self.keys.camera("*"),
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
            self.session.drop(key, error)

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
            case ["robot", robot, "camera"]:
                self._take_camera(robot, sample)
            case ["robot", robot, "image"]:
                self._take_picture(robot, lambda: self._picture(robot, sample))
            case _:
                raise CodecError("nothing is expected under this key")

    def _take_camera(self, robot: str, sample: Sample) -> None:
        announced = unpack(CameraAnnouncement, sample.payload, sample.encoding)
        if announced.robot != robot:
            raise CodecError(f"a camera of '{announced.robot}' under another robot's key")
        self._cameras[robot] = announced

    def _take_picture(self, robot: str, make: Callable[[], Picture]) -> None:
        """Feeds a picture, or tells the operator why there is none."""
        try:
            self.session.on_picture(make())
        except (CodecError, PictureError) as error:
            self.session.on_unreadable(robot, str(error))
            raise

    def _picture(self, robot: str, sample: Sample) -> Picture:
        if sample.encoding != ENCODING_JPEG or sample.attachment is None:
            raise PictureError(f"no JPEG with its header, but '{sample.encoding[:80]}'")
        header = unpack(ImageHeader, sample.attachment)
        if header.view.robot != robot:
            raise PictureError(f"an image of '{header.view.robot}' under the key of another robot")
        announced = self._cameras.get(robot)
        known = announced is not None and announced.epoch == header.view.epoch
        camera = announced.camera if announced is not None and known else None
        return self._checked(header, sample.payload, camera)

    def _checked(self, header: ImageHeader, jpeg: bytes, camera: Camera | None) -> Picture:
        """A picture whose size has been read and fits; nothing is decoded yet.

        Raises:
            PictureError: it is no JPEG, or not one of this camera.
        """
        if len(jpeg) > MAX_MESSAGE_BYTES:
            raise PictureError(f"a JPEG of {len(jpeg)} bytes")
        frame = frame_of(jpeg)
        check_size(frame.width, frame.height, header.scale, camera)
        return Picture(header.view, jpeg, header.scale, self.session.clock())

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
                    self._survive(
                        self.keys.view(robot), lambda robot=robot: self._fetch_newest(robot)
                    )

    def _fetch_newest(self, robot: str) -> None:
        """Asks for what the server has newest, so that one can pick in it at once."""
        view = self.session.newest_view(robot)
        if view is None:
            return
        try:
            self._take_picture(robot, lambda: self.fetch_picture(view))
        except UnreachableError as error:  # asked again soon; the screen says that it waits
            log.info("%s", error)

    def fetch_picture(self, view: ViewName) -> Picture:
        """Asks for the image of a view: its robot, or the server if it has been clicked in and the
        robot has forgotten it.

        Raises:
            UnreachableError: nobody answers, or nobody has it any more.
            PictureError: what was answered is no image of it.
        """
        if self._link is None:
            raise UnreachableError("not connected to a router yet")
        asked = f"seq={view.seq};epoch={view.epoch}"
        try:
            answer = self._link.query(f"{self.keys.view(view.robot)}?{asked}")
        except UnreachableError as robot_error:
            try:
                answer = self._link.query(f"{self.keys.server_view}?robot={view.robot};{asked}")
            except UnreachableError as error:
                raise UnreachableError(f"{robot_error}; {error}") from error
        kept = unpack(KeptView, answer.payload, answer.encoding)
        if kept.jpeg is None or kept.view.name != view:
            raise UnreachableError(f"{view.robot} has no image of its view {view.seq}")
        header = kept.image or ImageHeader(view=view, stamp_ns=kept.view.stamp_ns)
        if header.view != view:
            raise PictureError(f"view '{view}' came with the image of '{header.view}'")
        return self._checked(header, kept.jpeg, kept.view.camera)

    # ---- alignments ------------------------------------------------------------------------------

    def alignments(self, robot: str) -> dict[Pair, Alignment]:
        """The newest alignment heard of each pair of a robot."""
        found = {}
        for key, sample in tuple(self._alignments.items()):
            try:
                _, i, j, _ = self.keys.chunks(key)
                if robot in (i, j):
                    found[i, j] = unpack(Alignment, sample.payload, sample.encoding)
            except (FleetPoseError, ValueError) as error:
                self.session.drop(key, error)
        return found

    def _recall_alignment(self, pair: Pair) -> None:
        """Feeds the alignment that came before its pair was selected."""
        sample = self._alignments.get(self.keys.alignment(*pair))
        if sample is not None:
            self._inbox.store(sample)
