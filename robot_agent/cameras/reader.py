"""A thread that reads one stream: no image waits in a queue, and only those asked for are decoded.

A device that is read too rarely hands out images that are seconds old. So every image is grabbed
when it comes; decoding, the costly part of MJPG, is done for those alone that somebody waits for.
"""

import threading
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.cameras.stereo.video import Instant, Player

CLOSE_TIMEOUT_S = 1.0
_KEPT = 8  # images of one request; more come only if the other eye is far behind


class Still(NamedTuple):
    """One image: (H, W, 3) or (H, W) uint8, when it was taken on the streams' own clock, s, and
    UTC of the robot's clock.
    """

    image: npt.NDArray[np.uint8]
    at_s: float
    stamp_ns: int


class Reader:
    """Reads a player from a thread of its own.

    Args:
        player: the stream; the reader releases it.
        changed: notified when something has come; guards `stills`.

    Attributes:
        player: the stream.
        stills: what has come since the last `ask`, oldest first.
        ended: whether nothing more will come.
        failure: why it stopped, to be raised by who waits.
    """

    def __init__(self, player: Player, changed: threading.Condition) -> None:
        self.player = player
        self.stills: list[Still] = []
        self.ended = False
        self.failure: Exception | None = None
        self._changed = changed
        self._wanted = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"reader {player.name}", daemon=True)
        if player.live:
            self._thread.start()

    def ask(self, count: int, keep: bool = False) -> None:
        """Asks for so many images more, all grabbed from now on; a file begins to play.

        Args:
            count: how many.
            keep: whether to keep those that came before.
        """
        with self._changed:
            if not keep:
                self.stills = []
            self._wanted = count
        if not self._thread.is_alive() and not self.ended and not self._closed:
            self._thread.start()

    @property
    def ready(self) -> bool:
        """Whether all has come that was asked for, or no more will."""
        return self._wanted == 0 or self.ended

    def close(self) -> None:
        """Ends the thread; it releases the stream."""
        self._closed = True
        self.player.interrupt()
        if self._thread.ident is None:
            self.player.release()
        else:
            self._thread.join(CLOSE_TIMEOUT_S)

    def _run(self) -> None:
        try:
            while not self._closed and (instant := self.player.grab()) is not None:
                self._take(instant)
        except Exception as error:  # raised again in the thread that waits
            self.failure = error
        finally:
            with self._changed:
                self.ended = True
                self._changed.notify_all()
            self.player.release()

    def _take(self, instant: Instant) -> None:
        with self._changed:
            if not self._wanted:
                return
        image = self.player.retrieve()
        if image is None:
            return
        with self._changed:
            self.stills = [*self.stills, Still(image, *instant)][-_KEPT:]
            self._wanted = max(self._wanted - 1, 0)
            self._changed.notify_all()
