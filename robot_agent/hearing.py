"""What the server says that it has of this robot, and the silence that is told where it says
nothing.
"""

import logging
import re
import threading
import time
from collections.abc import Callable

from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Heard, View
from fleetpose.protocol.presence import LiveServer
from fleetpose.protocol.text import release
from fleetpose.protocol.transport import Sample

log = logging.getLogger(__name__)

UNHEARD_S = 5.0  # with views on their way and no word of the server, until that is told
LOST_S = 3.0  # without any router, until that is told: one that is restarted is back before
AGAIN_S = 60.0
ASKED_AGAIN_S = 3.0  # another cause is told at once
_LOOK_S = 0.2
_END_S = 1.0
_NUMBER = re.compile(r"\d+")


class Hearing:
    """Takes the server's words on this robot's views.

    Args:
        keys: of the site.
        name: the robot's.
        epoch: of its present life.
        server: the one that is listened to.
        drops: where what cannot be used is counted.
        confirm: is told the number of a view that the server has, and the seconds it lay there.
    """

    def __init__(
        self,
        keys: Keys,
        name: str,
        epoch: str,
        server: LiveServer,
        drops: Drops,
        confirm: Callable[[int, float], None],
    ) -> None:
        self._keys, self._name, self._epoch = keys, name, epoch
        self._server, self._drops, self._confirm = server, drops, confirm
        self._newest: Heard | None = None
        self._told_of: str | None = None

    @property
    def newest(self) -> Heard | None:
        """The last word of the server that lives, None without one."""
        newest = self._newest
        lives = newest is not None and newest.server_epoch == self._server.epoch
        return newest if lives else None

    def store(self, sample: Sample) -> None:
        """For the subscriber's callback."""
        try:
            heard = unpack(Heard, sample.payload, sample.encoding)
            if sample.key != self._keys.heard(heard.robot) or heard.robot != self._name:
                raise CodecError(f"what is heard of '{heard.robot}' under another robot's key")
            self._server.check(heard.server_epoch, "what is heard")
        except FleetPoseError as error:
            self._drops.note(sample.key, error)
            return
        before = self._newest
        same = before is not None and before.server_epoch == heard.server_epoch
        if before is not None and same and heard.n <= before.n:
            return
        self._newest = heard
        if not same:
            self._tell_versions(heard)
        if heard.epoch == self._epoch and heard.seq is not None:
            self._confirm(heard.seq, heard.waited_s)

    def _tell_versions(self, heard: Heard) -> None:
        """Once for each server: that it runs another version, and whether it reads this one's."""
        mine = release()
        if unread := unread_by(heard):
            log.warning("%s", unread)
        elif heard.version != mine:
            log.info("the server runs fleetpose %s, this robot %s", heard.version, mine)


def unread_by(heard: Heard) -> str:
    """That a server cannot read this robot's views; empty if it can."""
    sends = encoding_of(View).rpartition(";")[2]
    if sends in heard.reads:
        return ""
    return (
        f"the server (fleetpose {heard.version}) does not read {sends}, which this robot "
        f"(fleetpose {release()}) sends: bring both to one version"
    )


class SilenceWatch(threading.Thread):
    """Tells that the server has none of the views that are sent, or that no router is reached:
    after some seconds, and again each minute or when the cause is another, with the most probable
    cause.

    Args:
        unheard_s: for how long views have been sent in vain.
        connected: whether a router is reached.
        cause: finds the cause; may ask the network.
        at_first: what is wrong before any view was sent, empty if nothing; may ask the network,
            and ends early where the event is set that it is given.
    """

    def __init__(
        self,
        unheard_s: Callable[[], float],
        connected: Callable[[], bool],
        cause: Callable[[], str],
        at_first: Callable[[threading.Event], str],
    ) -> None:
        super().__init__(name="silence", daemon=True)
        self._unheard_s, self._connected = unheard_s, connected
        self._cause, self._at_first = cause, at_first
        self._connected_s = time.monotonic()
        self._stop_asked = threading.Event()

    def run(self) -> None:
        if fault := self._at_first(self._stop_asked):
            log.warning("%s", fault)
        told, told_s, asked_s = "", 0.0, 0.0
        while not self._stop_asked.wait(_LOOK_S):
            now_s, silent = time.monotonic(), self._silent()
            if not silent:
                if told and self._well():
                    log.info("the server hears this robot again")
                    told = ""
                continue
            if told and now_s - asked_s < ASKED_AGAIN_S:
                continue
            cause, asked_s = self._cause(), now_s
            kind = _NUMBER.sub("", cause)
            if kind != told or now_s - told_s > AGAIN_S:
                told, told_s = kind, now_s
                log.warning("%s: %s", silent, cause)

    def _silent(self) -> str:
        """That something is wrong for long enough to be told; else empty."""
        now_s, unheard_s = time.monotonic(), self._unheard_s()
        if self._connected():
            self._connected_s = now_s
        if unheard_s > UNHEARD_S:
            return f"not heard for {unheard_s:.0f} s"
        lost_s = now_s - self._connected_s
        return f"no router for {lost_s:.0f} s" if lost_s > LOST_S else ""

    def _well(self) -> bool:
        return self._unheard_s() == 0.0 and self._connected()

    def close(self) -> None:
        """Ends the thread, unless it waits for the network longer than that is worth."""
        self._stop_asked.set()
        self.join(_END_S)
