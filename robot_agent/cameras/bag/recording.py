"""A bag as a robot's camera: what it holds, and its frames in the order of their stamps."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError, CodecError, DataFolderError
from fleetpose.robot_agent.cameras.bag.framing import (
    CloudFraming,
    Framing,
    Lens,
    RgbdFraming,
    StereoFraming,
)
from fleetpose.robot_agent.cameras.bag.lenses import info_given, rig_given, rig_of
from fleetpose.robot_agent.cameras.bag.mounting import Mounting, camera_on_robot, mounting
from fleetpose.robot_agent.cameras.bag.options import RGBD_SKEW_MS, BagOptions
from fleetpose.robot_agent.cameras.base import Frame, OdometryPose
from fleetpose.robot_agent.cameras.folders.pairing import MAX_SKEW_MS
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.rosmsg.bag import Bag, Recorded
from fleetpose.rosmsg.camera_infos import CameraInfo, camera_info, frame_of
from fleetpose.rosmsg.images import bgr, is_compressed
from fleetpose.rosmsg.odometry import Track, odometry_reading
from fleetpose.rosmsg.roles import Wanted, choose, is_rectified
from fleetpose.rosmsg.stamps import Moment, Pairing, header_ns
from fleetpose.rosmsg.transforms import KEPT, Tf

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float64]
T = TypeVar("T")


class BagRecording:
    """A robot's camera in a bag. Infos and fixed transforms are read before the first image.

    Args:
        bag: open; it is closed with the recording.
        options: what the user says of it.
        calibration: in place of its infos.
        translation_unit: metres that one of the calibration's translation is; None: metres.

    Attributes:
        roles: which topic is what.
        tf: which frame hangs where.
        mounting: how the camera hangs on the robot.
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
        self._calibration, self._unit = calibration, translation_unit
        self._firsts: dict[str, Any] = {}
        wanted = Wanted(*(options.image, options.depth, options.left, options.right, options.cloud))
        self.roles = choose(bag.topics, options.namespace, wanted, self._frame_of)
        self.tf = self._first_tf()
        self._frame = self._frame_of(self.roles.image)
        self.mounting: Mounting = mounting(self.tf, options.base, self._frame)
        self.pairing = self._new_pairing()
        self._track = Track()
        self._framing = self._new_framing()

    def moments(self) -> Iterator[Moment[Recorded]]:
        """Both messages of each moment, not read yet."""
        self.pairing, self._track = self._new_pairing(), Track()
        streams = {self.roles.image: 0, self.roles.ranges: 1}
        names = {*streams, *(self.roles.tf if self.mounting.moves else ())}
        names |= {self.roles.odometry} if self.roles.odometry else set()
        for message in self._bag.messages(names):
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
        T_robot_camera = camera_on_robot(self.tf, self.mounting, self._frame, moment.stamp_ns)
        try:
            frame = self._framing.frame(image, ranges, moment.stamp_ns, T_robot_camera)
        except CodecError as error:
            log.warning("%s: a frame is left out: %s", self._bag.name, error)
            return None
        return replace(frame, odometry=self._odometry_at(moment.stamp_ns))

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
        usual = MAX_SKEW_MS if self.roles.form == "stereo" else RGBD_SKEW_MS
        return Pairing(2, int(1e6 * (self._options.max_skew_ms or usual)))

    def _note(self, message: Recorded) -> None:
        read = self._bag.read(message)
        if read is None:
            return
        if message.topic in self.roles.tf:
            self.tf.add(read, static=_is_static(message.topic))
            return
        try:
            reading = odometry_reading(read)
        except CodecError as error:
            log.warning("%s %s: %s", self._bag.name, message.topic, error)
            return
        self._track.add(replace(reading, stamp_ns=self._stamp_of(message)))

    def _odometry_at(self, stamp_ns: int) -> OdometryPose | None:
        reading = self._track.at(stamp_ns)
        if reading is None:
            return None
        T_odom_robot = reading.T_odom_child
        base = self.mounting.base
        if base and reading.child_frame and reading.child_frame != base:
            T_child_robot = self.tf.lookup(reading.child_frame, base, stamp_ns)
            T_odom_robot = T_odom_robot if T_child_robot is None else T_odom_robot @ T_child_robot
        return OdometryPose(T_odom_robot, reading.covariance)

    def _first(self, topic: str) -> Any:
        if topic not in self._firsts:
            self._firsts[topic] = self._bag.first(topic)
        return self._firsts[topic]

    def _frame_of(self, topic: str) -> str:
        first = self._first(topic)
        return "" if first is None else frame_of(first)

    def _first_tf(self) -> Tf:
        """All fixed transforms, and of the others as many as say what hangs where."""
        tf = Tf()
        for topic in self.roles.tf:
            static = _is_static(topic)
            for message in islice(self._bag.messages([topic]), None if static else KEPT):
                if (read := self._bag.read(message)) is not None:
                    tf.add(read, static)
        return tf

    def _info(self, topic: str, info_topic: str | None) -> CameraInfo:
        if info_topic is not None and (message := self._first(info_topic)) is not None:
            return camera_info(message)
        raise CalibrationError(
            f"{self._bag.name} has no CameraInfo of {topic}: give --calibration FILE"
        )

    def _lens(self, topic: str, info_topic: str | None) -> Lens:
        if self._calibration is not None:
            size = _size_of(self._readable(topic))
            return Lens(topic, info_given(self._calibration, size, self._frame_of(topic)), True)
        return Lens(topic, self._info(topic, info_topic), is_rectified(topic))

    def _new_framing(self) -> Framing:
        make = {"rgbd": self._rgbd, "stereo": self._stereo, "cloud": self._cloud}
        return make[self.roles.form]()

    def _rgbd(self) -> Framing:
        roles = self.roles
        colour = self._lens(roles.image, roles.infos[0])
        frames = self._frame, self._frame_of(roles.ranges)
        depth_info = self._first(roles.infos[1]) if roles.infos[1] else None
        same_size = depth_info is None or (depth_info.width, depth_info.height) == colour.info.size
        if (frames[0] == frames[1] or not all(frames)) and same_size:
            return RgbdFraming(colour)
        depth = Lens(
            roles.ranges, self._info(roles.ranges, roles.infos[1]), is_rectified(roles.ranges)
        )
        return RgbdFraming(colour, depth, self._between(*frames))

    def _stereo(self) -> Framing:
        roles = self.roles
        told = None if self.mounting.why_not else self._camera_now()
        if self._calibration is not None:
            size = _size_of(self._readable(roles.image))
            return StereoFraming(
                StereoMatcher(rig_given(self._calibration, size, self._unit, told))
            )
        topics = (roles.image, roles.ranges)
        left, right = (self._info(t, i) for t, i in zip(topics, roles.infos, strict=True))
        rig = rig_of(left, right, is_rectified(roles.image), self._camera_now())
        return StereoFraming(StereoMatcher(rig))

    def _cloud(self) -> Framing:
        roles = self.roles
        colour = self._lens(roles.image, roles.infos[0])
        frames = self._frame, self._frame_of(roles.ranges)
        return CloudFraming(colour, None if frames[0] == frames[1] else self._between(*frames))

    def _camera_now(self) -> Floats:
        return camera_on_robot(self.tf, self.mounting, self._frame)

    def _between(self, target: str, source: str) -> Floats:
        T_target_source = self.tf.lookup(target, source)
        if T_target_source is None:
            raise CalibrationError(
                f"{self._bag.name}: {self.roles.ranges} is in frame '{source}', {self.roles.image} "
                f"in '{target}', and tf joins them by nothing: record /tf_static too, or name "
                "topics of one frame (--image, --depth)"
            )
        return T_target_source

    def _readable(self, topic: str) -> Any:
        first = self._first(topic)
        if first is None:
            raise DataFolderError(f"{self._bag.name}: no message of {topic} can be read")
        return first


def with_next(items: Iterator[T]) -> Iterator[tuple[T, T | None]]:
    """Each item with the one after it, None after the last: what came between is read by then."""
    item = next(items, None)
    while item is not None:
        following = next(items, None)
        yield item, following
        item = following


def _is_static(topic: str) -> bool:
    return topic.endswith("tf_static")


def _size_of(image: Any) -> tuple[int, int]:
    """Width and height, px."""
    if is_compressed(image):
        height, width = bgr(image).shape[:2]
        return width, height
    return int(image.width), int(image.height)
