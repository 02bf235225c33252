"""The newest pose of every robot, as the server that lives publishes them."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RobotPose
from fleetpose.protocol.presence import LiveServer
from fleetpose.protocol.transport import Sample

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
        server: the one whose poses are taken.
        take: is given each pose that is new.
    """

    def __init__(
        self,
        keys: Keys,
        drops: Drops,
        server: LiveServer,
        take: Callable[[RobotPose], None] = lambda pose: None,
    ) -> None:
        self._keys, self._drops, self._server, self._take = keys, drops, server, take
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Sample, float]] = deque()
        self._closed = False
        self._newest: dict[str, Received] = {}
        self._valid_until_s: dict[str, dict[tuple[str, int], float]] = {}  # by epoch and n
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

    def is_valid(self, pose: RobotPose) -> bool:
        """Whether a pose was received here, not too long ago by this process's monotonic clock, and
        no other server has come since: its poses count then.
        """
        if self._server.epoch not in (None, pose.server_epoch):
            return False
        with self._changed:
            known = self._valid_until_s.get(pose.robot, {})
        return time.monotonic() < known.get((pose.server_epoch, pose.n), 0.0)

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
        self._server.check(pose.server_epoch, "a pose")
        known = self._newest.get(pose.robot)
        if known is None and len(self._newest) >= MAX_ROBOTS:
            raise CodecError(f"more than {MAX_ROBOTS} robots have poses")
        if known is None or pose.server_epoch != known.pose.server_epoch or pose.n > known.pose.n:
            valid = self._valid_until_s.get(pose.robot, {}).items()
            until_s = {which: until for which, until in valid if until > at_s}
            until_s[pose.server_epoch, pose.n] = at_s + pose.valid_for_s
            with self._changed:
                self._newest[pose.robot] = Received(pose, at_s)
                self._valid_until_s[pose.robot] = until_s
            self._take(pose)
