"""The newest pose of every robot, as the server publishes them."""

import logging
import threading
import time
from collections import deque
from dataclasses import dataclass

from protocol.codec import unpack
from protocol.errors import CodecError
from protocol.messages import RobotPose
from protocol.transport import Sample

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Received:
    """A pose and the monotonic second of its arrival."""

    pose: RobotPose
    at_s: float


class PoseBoard:
    """Takes pose samples as they come and decodes them when somebody looks."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: deque[tuple[Sample, float]] = deque(maxlen=4096)
        self._newest: dict[str, Received] = {}
        self.refused = 0

    def store(self, sample: Sample) -> None:
        """For the subscriber's callback: only stores."""
        self._waiting.append((sample, time.monotonic()))

    def newest(self) -> dict[str, Received]:
        """The newest pose per robot. Repeated, older and damaged messages change nothing."""
        with self._lock:
            while self._waiting:
                self._apply(*self._waiting.popleft())
            return dict(self._newest)

    def _apply(self, sample: Sample, at_s: float) -> None:
        try:
            pose = unpack(RobotPose, sample.payload, sample.encoding)
        except CodecError as error:
            self.refused += 1
            log.warning("pose refused key=%s reason=%s", sample.key, error)
            return
        known = self._newest.get(pose.robot)
        if known is None or pose.server_epoch != known.pose.server_epoch or pose.n > known.pose.n:
            self._newest[pose.robot] = Received(pose, at_s)
