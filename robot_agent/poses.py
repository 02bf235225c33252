"""The newest pose of every robot, as the server publishes them."""

import threading
import time
from collections import deque
from dataclasses import dataclass

from protocol.codec import unpack
from protocol.drops import Drops
from protocol.errors import CodecError, FleetPoseError
from protocol.keys import Keys
from protocol.messages import RobotPose
from protocol.transport import Sample

MAX_WAITING = 4096
MAX_ROBOTS = 1000


@dataclass(frozen=True)
class Received:
    """A pose and the monotonic second of its arrival."""

    pose: RobotPose
    at_s: float


class PoseBoard:
    """Takes pose samples as they come and decodes them in a thread of its own.

    Args:
        keys: of the site.
        drops: where what cannot be used is counted.
    """

    def __init__(self, keys: Keys, drops: Drops) -> None:
        self._keys, self._drops = keys, drops
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Sample, float]] = deque()
        self._closed = False
        self._newest: dict[str, Received] = {}
        self._thread = threading.Thread(target=self._run, name="poses", daemon=True)
        self._thread.start()

    def store(self, sample: Sample) -> None:
        """For the subscriber's callback: only stores."""
        with self._changed:
            full = len(self._waiting) >= MAX_WAITING
            if not full:
                self._waiting.append((sample, time.monotonic()))
                self._changed.notify()
        if full:
            self._drops.note(sample.key, "more poses than can be read")

    def newest(self) -> dict[str, Received]:
        """The newest pose per robot. Repeated, older and damaged messages change nothing."""
        with self._changed:
            return dict(self._newest)

    def close(self) -> None:
        """Ends the thread."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        self._thread.join()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                sample, at_s = self._waiting.popleft()
            try:
                self._apply(sample, at_s)
            except FleetPoseError as error:
                self._drops.note(sample.key, error)

    def _apply(self, sample: Sample, at_s: float) -> None:
        pose = unpack(RobotPose, sample.payload, sample.encoding)
        if sample.key != self._keys.pose(pose.robot):
            raise CodecError(f"a pose of '{pose.robot}' under another robot's key")
        known = self._newest.get(pose.robot)
        if known is None and len(self._newest) >= MAX_ROBOTS:
            raise CodecError(f"more than {MAX_ROBOTS} robots have poses")
        if known is None or pose.server_epoch != known.pose.server_epoch or pose.n > known.pose.n:
            with self._changed:
                self._newest[pose.robot] = Received(pose, at_s)
