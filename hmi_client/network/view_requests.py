"""Asking for views: the newest of robots whose pictures do not come by themselves, those of a
question or of an old correspondence, and where the pictures on the screen have depth.
"""

import logging
import threading
import time
from collections.abc import Callable

from fleetpose.hmi_client.errors import PictureError
from fleetpose.hmi_client.model.depths import Depths
from fleetpose.hmi_client.model.records import Picture
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.message_decoder import checked_picture
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import CodecError, FleetPoseError, UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import ImageHeader, KeptView, View, ViewName
from fleetpose.protocol.transport import Link

log = logging.getLogger(__name__)
PATIENCE_S = 0.6  # without a live picture for this long, the robot is asked for its newest view
RETRY_S = 2.0
_POLL_S = 0.1
_MOST_TRIES = 1000


class Fetcher:
    """Follows the session in a thread of its own, because an answer may take long.

    Args:
        session: what is followed.
        keys: the keys of the site.
        link: where is asked.
    """

    def __init__(self, session: OperatorSession, keys: Keys, link: Link) -> None:
        self._session = session
        self._keys = keys
        self._link = link
        self._next_s: dict[str, float] = {}

    def run(self, stop: threading.Event) -> None:
        """Asks until told to stop."""
        while not stop.is_set():
            seen = self._session.revisions()
            for view in self._session.wanted_pictures():
                self._try(f"picture {view}", view.robot, lambda view=view: self._fetch_held(view))
            for view in self._session.wanted_depths():
                self._try(f"depths {view}", view.robot, lambda view=view: self._fetch_depths(view))
            if self._session.seconds_selected >= PATIENCE_S:
                for robot in self._session.pair or ():
                    self._fetch_newest(robot)
            self._session.wait_change(seen, ("selection",), _POLL_S)

    def picture(self, view: ViewName) -> Picture:
        """Asks for the image of a view: its robot, or the server if it has been clicked in and the
        robot has forgotten it.

        Raises:
            UnreachableError: nobody answers, or nobody has it any more.
            PictureError: what was answered is no image of it.
        """
        kept = self._kept(view, "")
        if kept.jpeg is None:
            raise UnreachableError(f"{view.robot} has no image of its view {view.seq}")
        header = kept.image or ImageHeader(view=view, stamp_ns=kept.view.stamp_ns)
        if header.view != view:
            raise PictureError(f"view '{view}' came with the image of '{header.view}'")
        return checked_picture(header, kept.jpeg, kept.view.camera, self._session.clock())

    def view(self, view: ViewName) -> View:
        """Asks for a view without its image.

        Raises:
            UnreachableError: nobody answers, or nobody has it any more.
        """
        return self._kept(view, "image=no;").view

    # ---- inside ----------------------------------------------------------------------------------

    def _try(self, what: str, robot: str, work: Callable[[], None]) -> None:
        """Not again and again: a robot that does not answer is left alone for a while."""
        now = time.monotonic()
        if now < self._next_s.get(what, 0.0):
            return
        if len(self._next_s) > _MOST_TRIES:
            self._next_s.clear()
        self._next_s[what] = now + RETRY_S
        try:
            work()
        except FleetPoseError as error:
            self._session.drop(self._keys.view(robot), error)

    def _fetch_newest(self, robot: str) -> None:
        """Asks for what the server has newest, so that one can pick in it at once."""
        view = self._session.newest_view(robot)
        if view is None or self._session.picture(robot) is not None:
            return

        def fetch() -> None:
            try:
                self._session.on_picture(self.picture(view))
            except UnreachableError as error:  # asked again soon; the screen says that it waits
                log.info("%s", error)
            except (CodecError, PictureError) as error:
                self._session.on_unreadable(robot, str(error))
                raise

        self._try(f"newest {robot}", robot, fetch)

    def _fetch_held(self, view: ViewName) -> None:
        try:
            self._session.on_fetched(self.picture(view))
        except FleetPoseError as error:
            self._session.on_not_fetched(view, str(error))

    def _fetch_depths(self, view: ViewName) -> None:
        try:
            self._session.on_depths(Depths.of(self.view(view)))
        except UnreachableError as error:  # one can pick without; the server has the last word
            log.info("%s", error)

    def _kept(self, view: ViewName, options: str) -> KeptView:
        asked = f"{options}seq={view.seq};epoch={view.epoch}"
        try:
            answer = self._link.query(f"{self._keys.view(view.robot)}?{asked}")
        except UnreachableError as robot_error:
            try:
                answer = self._link.query(f"{self._keys.server_view}?robot={view.robot};{asked}")
            except UnreachableError as error:
                raise UnreachableError(f"{robot_error}; {error}") from error
        kept = unpack(KeptView, answer.payload, answer.encoding)
        if kept.view.name != view:
            raise UnreachableError(f"{view.robot} has answered with another view than {view.seq}")
        return kept
