"""A robot's camera among its topics: which is what, where it sits, frames of two messages."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.cameras.base import Frame, OdometryPose
from fleetpose.robot_agent.cameras.folders.pairing import MAX_SKEW_MS
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.topics.framing import (
    CloudFraming,
    Framing,
    Lens,
    RgbdFraming,
    StereoFraming,
)
from fleetpose.robot_agent.cameras.topics.lenses import info_given, rig_given, rig_of
from fleetpose.robot_agent.cameras.topics.mounting import camera_on_robot, mounting
from fleetpose.robot_agent.cameras.topics.options import RGBD_SKEW_MS, TopicOptions
from fleetpose.robot_agent.cameras.topics.up import Up, UpSense
from fleetpose.rosmsg.bag import Topic
from fleetpose.rosmsg.camera_infos import CameraInfo, camera_info, frame_of
from fleetpose.rosmsg.images import bgr, is_compressed
from fleetpose.rosmsg.motion.inertial import inertial_reading
from fleetpose.rosmsg.motion.odometry import OdometryReading, Track, odometry_reading
from fleetpose.rosmsg.roles import Roles, Wanted, choose, is_rectified
from fleetpose.rosmsg.transforms import Tf
from fleetpose.rosmsg.typestore import as_defined

Floats = npt.NDArray[np.float64]

_FURTHEST_M = 1e8  # that an odometry may tell the fleet


class TopicSource(Protocol):
    """Where messages come from: a bag, or a robot that runs."""

    @property
    def name(self) -> str:
        """For errors."""
        ...

    @property
    def what(self) -> str:
        """What it is, in words."""
        ...

    @property
    def topics(self) -> Sequence[Topic]:
        """Those that there are."""
        ...

    def first(self, topic: str) -> Any | None:
        """The first message of a topic that can be read, None without one."""
        ...

    def transforms(self, topic: str) -> Iterator[Any]:
        """Of a topic of tf, as many messages as say what hangs where."""
        ...


class Sensor:
    """A robot's camera. Infos and fixed transforms are read before the first image.

    Args:
        source: of its messages.
        options: what the user says of them.
        calibration: in place of its infos.
        translation_unit: metres that one of the calibration's translation is; None: metres.

    Attributes:
        roles: which topic is what.
        tf: which frame hangs where.
        mounting: how the camera hangs on the robot.
        up: what tells where up is.

    Raises:
        DataFolderError: there is no camera among the topics.
        CalibrationError: its infos cannot be used.
        CodecError: a message lacks what its type has in ROS.
    """

    def __init__(
        self,
        source: TopicSource,
        options: TopicOptions,
        calibration: Path | None = None,
        translation_unit: float | None = None,
    ) -> None:
        self._source, self._options = source, options
        self._calibration, self._unit = calibration, translation_unit
        self._firsts: dict[str, Any] = {}
        with as_defined():
            self.roles = self._new_roles()
            self.tf = self._first_tf()
            self._frame = self._frame_of(self.roles.image)
            self.mounting = mounting(self.tf, options.base, self._frame, source.what)
            self._framing = self._new_framing()
        self.restart()

    @property
    def streams(self) -> tuple[str, str]:
        """The topics of image and ranges, of which each frame needs a message."""
        return self.roles.image, self.roles.ranges

    @property
    def followed(self) -> set[str]:
        """The small topics whose messages `note` is to be given."""
        tf = self.roles.tf if self.mounting.moves or self.up.needs("tf") else ()
        return {*tf, *([self.roles.odometry] if self.roles.odometry else [])}

    @property
    def sampled(self) -> set[str]:
        """Fast topics of which `note` needs some messages around each frame."""
        imu = self.roles.imu
        return {imu} if imu is not None and self.up.needs("imu") else set()

    @property
    def max_skew_ns(self) -> int:
        """What is taken further apart belongs to two moments."""
        usual = MAX_SKEW_MS if self.roles.form == "stereo" else RGBD_SKEW_MS
        return int(1e6 * (self._options.max_skew_ms or usual))

    def restart(self) -> None:
        """Forgets where the robot was: a recording begins anew."""
        self._track = Track()
        self.up = UpSense(self._options.up, self.tf, self.mounting, self._frame)

    def note(self, topic: str, message: Any, stamp: Callable[[int], int] = int) -> None:
        """Takes a message of a followed topic.

        Args:
            topic: its name.
            message: as it was read.
            stamp: gives the stamp that counts in place of its header's, ns.

        Raises:
            CodecError: it says what cannot be.
        """
        with as_defined():
            self._note(topic, message, stamp)

    def _note(self, topic: str, message: Any, stamp: Callable[[int], int]) -> None:
        if topic in self.roles.tf:
            self.tf.add(message, static=is_static(topic))
            return
        if topic == self.roles.imu:
            if (felt := inertial_reading(message)) is not None:
                self.up.note(replace(felt, stamp_ns=stamp(felt.stamp_ns)))
            return
        reading = odometry_reading(message)
        self._track.add(replace(reading, stamp_ns=stamp(reading.stamp_ns)))

    def frame(self, image: Any, ranges: Any, stamp_ns: int) -> Frame:
        """The frame of two messages, with what is known of the robot at that moment.

        Raises:
            CodecError: a message is damaged.
            CalibrationError: images do not fit their infos.
        """
        T_robot_camera = camera_on_robot(self.tf, self.mounting, self._frame, stamp_ns)
        with as_defined():
            frame = self._framing.frame(image, ranges, stamp_ns, T_robot_camera)
        reading = self._track.at(stamp_ns)
        T_odom_robot = None if reading is None else self._T_odom_robot(reading, stamp_ns)
        if reading is None or T_odom_robot is None:
            return with_up(frame, self.up.at(stamp_ns, T_robot_camera, None))
        frame = replace(frame, odometry=OdometryPose(T_odom_robot, reading.covariance))
        level = T_odom_robot if self._is_joined(reading) else None
        return with_up(frame, self.up.at(stamp_ns, T_robot_camera, level))

    def _is_joined(self, reading: OdometryReading) -> bool:
        """Whether tf knows the robot's body and how the body of its odometry hangs on it."""
        base, child = self.mounting.base, reading.child_frame
        return bool(base) and (child in ("", base) or self.tf.chain(child, base) is not None)

    def _new_roles(self) -> Roles:
        named = self._options
        wanted = Wanted(named.image, named.depth, named.left, named.right, named.cloud)
        return choose(self._source.topics, named.namespace, wanted, self._frame_of)

    def _T_odom_robot(self, reading: OdometryReading, stamp_ns: int) -> Floats | None:
        """None of a place that cannot be, by tf or by itself."""
        T_odom_robot, base = reading.T_odom_child, self.mounting.base
        if base and reading.child_frame and reading.child_frame != base:
            T_child_robot = self.tf.lookup(reading.child_frame, base, stamp_ns)
            T_odom_robot = T_odom_robot if T_child_robot is None else T_odom_robot @ T_child_robot
        return T_odom_robot if (np.abs(T_odom_robot[:3, 3]) < _FURTHEST_M).all() else None

    def _first(self, topic: str) -> Any:
        if topic not in self._firsts:
            self._firsts[topic] = self._source.first(topic)
        return self._firsts[topic]

    def _frame_of(self, topic: str) -> str:
        first = self._first(topic)
        return "" if first is None else frame_of(first)

    def _first_tf(self) -> Tf:
        tf = Tf()
        for topic in self.roles.tf:
            for message in self._source.transforms(topic):
                tf.add(message, is_static(topic))
        return tf

    def _info(self, topic: str, info_topic: str | None) -> CameraInfo:
        if info_topic is not None and (message := self._first(info_topic)) is not None:
            return camera_info(message)
        raise CalibrationError(
            f"{self._source.name} has no CameraInfo of {topic}: give --calibration FILE"
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
                f"{self._source.name}: {self.roles.ranges} is in frame '{source}', "
                f"{self.roles.image} in '{target}', and tf joins them by nothing: /tf_static is "
                "needed too, or name topics of one frame (--image, --depth)"
            )
        return T_target_source

    def _readable(self, topic: str) -> Any:
        first = self._first(topic)
        if first is None:
            raise DataFolderError(f"{self._source.name}: no message of {topic} can be read")
        return first


def with_up(frame: Frame, up: Up | None) -> Frame:
    """A frame that says where up is in its camera's axes, of up in the robot's."""
    if up is None:
        return frame
    up_camera = frame.model.T_robot_camera[:3, :3].T @ up.direction
    return replace(frame, up_camera=up_camera, up_sigma_rad=up.sigma_rad)


def is_static(topic: str) -> bool:
    """Whether a topic of tf tells what never moves."""
    return topic.endswith("tf_static")


def _size_of(image: Any) -> tuple[int, int]:
    """Width and height, px."""
    if is_compressed(image):
        height, width = bgr(image).shape[:2]
        return width, height
    return int(image.width), int(image.height)
