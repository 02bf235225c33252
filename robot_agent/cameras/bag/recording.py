"""A bag as a robot's camera: what it holds, and its frames in the order of their stamps."""

import logging
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from fleetpose.protocol.errors import CodecError
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.cameras.topics.sensor import Sensor, is_static
from fleetpose.rosmsg.bag import Bag, Recorded, Topic
from fleetpose.rosmsg.stamps import Moment, Pairing, header_ns
from fleetpose.rosmsg.transforms import KEPT

log = logging.getLogger(__name__)

T = TypeVar("T")


class _Source:
    """A bag as a `TopicSource`: all fixed transforms, and some of the others."""

    def __init__(self, bag: Bag) -> None:
        self._bag = bag
        self.name, self.what = bag.name, "the bag"
        self.topics: Sequence[Topic] = bag.topics
        self.first = bag.first

    def transforms(self, topic: str) -> Iterator[Any]:
        messages = self._bag.messages([topic])
        for message in islice(messages, None if is_static(topic) else KEPT):
            if (read := self._bag.read(message)) is not None:
                yield read


class BagRecording:
    """A robot's camera in a bag.

    Args:
        bag: open; it is closed with the recording.
        options: what the user says of it.
        calibration: in place of its infos.
        translation_unit: metres that one of the calibration's translation is; None: metres.

    Attributes:
        sensor: what its topics are.
        pairing: of the last iteration: skews, and what had no partner.

    Raises:
        DataFolderError: there is no camera in it.
        CalibrationError: its infos cannot be used.
    """

    def __init__(
        self,
        bag: Bag,
        options: BagOptions,
        calibration: Path | None = None,
        translation_unit: float | None = None,
    ) -> None:
        self._bag, self._options = bag, options
        self.sensor = Sensor(_Source(bag), options, calibration, translation_unit)
        self.roles, self.mounting = self.sensor.roles, self.sensor.mounting
        self.pairing = self._new_pairing()

    def moments(self) -> Iterator[Moment[Recorded]]:
        """Both messages of each moment, not read yet."""
        self.pairing = self._new_pairing()
        self.sensor.restart()
        streams = {topic: k for k, topic in enumerate(self.sensor.streams)}
        for message in self._bag.messages({*streams, *self.sensor.followed}):
            if message.topic not in streams:
                self._note(message)
                continue
            try:
                stamp_ns = self._stamp_of(message)
            except CodecError as error:
                log.warning("%s: %s", self._bag.name, error)
                continue
            yield from self.pairing.add(streams[message.topic], stamp_ns, message)
        yield from self.pairing.rest()

    def frame(self, moment: Moment[Recorded]) -> Frame | None:
        """The frame of a moment, None where a message of it is damaged, which is told.

        Raises:
            CalibrationError: images do not fit their infos.
        """
        image, ranges = (self._bag.read(message) for message in moment.items)
        if image is None or ranges is None:
            return None
        try:
            return self.sensor.frame(image, ranges, moment.stamp_ns)
        except CodecError as error:
            log.warning("%s: a frame is left out: %s", self._bag.name, error)
            return None

    def frames(self) -> Iterator[Frame]:
        """All frames, as fast as they can be read."""
        for moment, _ in with_next(self.moments()):
            if (frame := self.frame(moment)) is not None:
                yield frame

    def close(self) -> None:
        """Closes the bag."""
        self._bag.close()

    def _stamp_of(self, message: Recorded) -> int:
        by_recorder = self._options.stamps == "receive"
        return message.received_ns if by_recorder else header_ns(message)

    def _new_pairing(self) -> Pairing[Recorded]:
        return Pairing(2, self.sensor.max_skew_ns)

    def _note(self, message: Recorded) -> None:
        read = self._bag.read(message)
        if read is None:
            return
        by_recorder = self._options.stamps == "receive"
        try:
            self.sensor.note(
                message.topic, read, lambda own: message.received_ns if by_recorder else own
            )
        except CodecError as error:
            log.warning("%s %s: %s", self._bag.name, message.topic, error)


def with_next(items: Iterator[T]) -> Iterator[tuple[T, T | None]]:
    """Each item with the one after it, None after the last: what came between is read by then."""
    item = next(items, None)
    while item is not None:
        following = next(items, None)
        yield item, following
        item = following
