"""What a robot's own program uses: push frames, get poses.

robot = FleetRobot("r7", SessionSettings(connect=("tcp/10.0.0.1:7447",)), camera=model)
robot.push(image, depth_m, stamp_ns, T_odom_robot)
pose = robot.pose()
if pose is not None and pose.located and not robot.is_stale(pose): ...
else: print(robot.why())
robot.close()
"""

import logging
import time
from dataclasses import replace
from functools import partial
from types import TracebackType
from typing import Self

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CalibrationError, CodecError, UnreachableError
from fleetpose.protocol.keys import EVERY_SERVER, Keys, checked_name, new_epoch, site_of
from fleetpose.protocol.messages import Camera, Odometry, RelativePose, RobotPose, ViewName, WhyNot
from fleetpose.protocol.presence import LiveServer, Presence
from fleetpose.protocol.session.echo import fault_behind_tls
from fleetpose.protocol.transport import Link, SessionSettings, open_session
from fleetpose.robot_agent.cameras.base import (
    DepthImage,
    DisparityImage,
    Frame,
    Ranges,
    ScatteredPoints,
)
from fleetpose.robot_agent.cameras.frozen import Repeats
from fleetpose.robot_agent.features.depth_picture import picture_of
from fleetpose.robot_agent.hearing import Hearing, SilenceWatch, unread_by
from fleetpose.robot_agent.poses import PoseBoard
from fleetpose.robot_agent.sender import Sender, SenderSettings

log = logging.getLogger(__name__)

_ASK_S = 1.0


class FleetRobot:
    """One robot of the fleet: its views go out, poses come back. Close it, or use it in a `with`.

    Methods may be called from any thread; none of them waits for the network but `relative_pose`,
    `why` and `flush`. Only the server that lives is listened to, by its token; what others publish
    in its place is refused, counted in `drops` and logged.

    Attributes:
        drops: what arrived and could not be used, counted by reason.
    """

    def __init__(
        self,
        name: str,
        session: SessionSettings,
        site: str = "demo",
        camera: Camera | None = None,
        settings: SenderSettings | None = None,
        takeover: bool = False,
    ) -> None:
        """Joins the fleet.

        Args:
            name: the robot's name, unique in its site.
            session: how to reach the router.
            site: the fleet's site.
            camera: the model of the camera; may be left out where every frame brings its own.
            settings: what is computed, sent and kept.
            takeover: start even if another agent is alive under the name.

        Raises:
            NameRefusedError: the name or the site does not follow the rules.
            UnreachableError: no router.
            NameTakenError: another agent is alive under the name.
        """
        self.name = checked_name(name)
        self.epoch = new_epoch()
        self._keys = Keys(site)
        self._camera = camera
        self._seq = 0
        self._repeats = Repeats(name)
        self.drops = Drops()
        self._link = Link(open_session(session))
        self._server = LiveServer(self._link, self._keys)
        self._session = session
        self._poses = PoseBoard(self._keys, self.drops, self._server, self._posed)
        try:
            self._presence = Presence(
                self._link,
                everybody=self._keys.robot_alive(name, "*"),
                mine=self._keys.robot_alive(name, self.epoch),
                who=f"a robot named '{name}'",
                remedy="choose another --name, end that agent, or start with --takeover",
                takeover=takeover,
            )
            self._sender = Sender(
                self._link, self._keys, name, self.epoch, settings, self._is_confirmed
            )
            self._hearing = Hearing(
                self._keys, name, self.epoch, self._server, self.drops, self._sender.confirm
            )
            self._link.on_latched(self._keys.heard(name), self._hearing.store)
            self._odometry = self._link.latched(self._keys.odometry(name))
            self._link.on_latched(self._keys.poses, self._poses.store)
        except BaseException:
            self._link.close()
            self._poses.close()
            raise
        self._silence = SilenceWatch(
            self._sender.unheard_s,
            lambda: self._link.connected,
            self._why_unheard,
            partial(fault_behind_tls, session.config_file),
        )
        self._silence.start()
        if camera is not None:
            self._sender.announce(camera)

    def push(
        self,
        image: npt.NDArray[np.uint8] | None,
        ranges: Ranges | npt.NDArray[np.floating],
        stamp_ns: int | None = None,
        T_odom_robot: npt.NDArray[np.float64] | None = None,
        odometry_covariance: npt.NDArray[np.float64] | None = None,
        up_camera: npt.NDArray[np.float64] | None = None,
        up_sigma_rad: float | None = None,
        live: bool = False,
    ) -> ViewName:
        """Sends what the robot sees now; returns at once.

        Args:
            image: (H, W, 3) uint8 BGR, rectified, full resolution; None of a sensor that has none,
                e.g. time of flight: its pairs are aligned by the shape of their surfaces.
            ranges: what was measured on its grid; an array (H, W) is depth in metres, nan or 0
                where there is none.
            stamp_ns: UTC of the robot's clock; now if not given.
            T_odom_robot: the robot in its own odometry frame, (4, 4), metres.
            odometry_covariance: (6, 6) of it, rotation then translation; 1 cm and 0.5 deg if not
                given.
            up_camera: unit vector against gravity in the camera frame.
            up_sigma_rad: its sigma.
            live: whether the image is a device's: the server is told when it repeats itself to the
                last bit, as no sensor does, and does not take what it shows for now.

        Returns:
            The name that the view will have.

        Raises:
            CalibrationError: no camera was given, or the image is not of its size.
            NameTakenError: another agent has taken the name over.
        """
        if self._camera is None:
            raise CalibrationError("push needs the camera's model: give FleetRobot a camera")
        ranges = _copied(ranges)  # the caller may reuse the buffers
        drawn = image is None
        image = picture_of(ranges, self._camera) if image is None else image.copy()
        frame = Frame(
            stamp_ns=time.time_ns() if stamp_ns is None else stamp_ns,
            image=image,
            ranges=ranges,
            model=self._camera,
            up_camera=up_camera,
            up_sigma_rad=up_sigma_rad,
            raw=(image,) if live else (),
            has_image=not drawn,
        )
        if T_odom_robot is not None:
            self.push_odometry(T_odom_robot, frame.stamp_ns, odometry_covariance)
        return self.push_frame(frame)

    def push_frame(self, frame: Frame) -> ViewName:
        """Sends a frame with a camera model of its own, and its odometry if it has some; returns at
        once.

        The frame must not be changed afterwards.

        Raises:
            CalibrationError: image or ranges do not fit the camera model, or up is no direction.
            NameTakenError: another agent has taken the name over.
        """
        self._presence.check()
        _check_sizes(frame)
        _check_up(frame.up_camera)
        if frame.raw:
            frozen_s = self._repeats.frozen_s(frame.raw, time.monotonic())
            frame = replace(frame, frozen_s=frozen_s)
        if (odometry := frame.odometry) is not None:
            self.push_odometry(odometry.T_odom_robot, frame.stamp_ns, odometry.covariance)
        name = ViewName(robot=self.name, epoch=self.epoch, seq=self._seq)
        self._seq += 1
        self._sender.send(name, frame)
        return name

    def push_odometry(
        self,
        T_odom_robot: npt.NDArray[np.float64],
        stamp_ns: int,
        covariance: npt.NDArray[np.float64] | None = None,
    ) -> None:
        """Sends where the robot is in its own odometry frame."""
        if covariance is None:
            covariance = np.diag([np.deg2rad(0.5) ** 2] * 3 + [0.01**2] * 3)
        odometry = Odometry(
            robot=self.name,
            epoch=self.epoch,
            stamp_ns=stamp_ns,
            T_odom_robot=T_odom_robot,
            covariance=covariance,
        )
        self._odometry.put(pack(odometry), encoding_of(Odometry))

    def pose(self) -> RobotPose | None:
        """The newest pose of this robot, None before the first. Ask `is_stale` before acting, and
        whether it is `located`; `why_not` says why it is not.
        """
        return self.poses().get(self.name)

    def is_stale(self, pose: RobotPose) -> bool:
        """Whether a pose, of any robot, is no longer to be acted on: its time is over, counted from
        its arrival by the monotonic clock, or another server has come since. Wall clocks have no
        say. What did not arrive here is stale.
        """
        return not self._poses.is_valid(pose)

    def poses(self) -> dict[str, RobotPose]:
        """The newest pose of every robot."""
        return {name: received.pose for name, received in self._poses.newest().items()}

    def age_s(self, robot: str) -> float | None:
        """How old a robot's newest pose is: its age when sent plus the time since it arrived."""
        received = self._poses.newest().get(robot)
        if received is None:
            return None
        return received.pose.age_s + time.monotonic() - received.at_s

    @property
    def server_alive(self) -> bool:
        """Whether a server of the site is there now."""
        return self._server.epoch is not None

    def why(self, timeout_s: float = 3.0) -> str:
        """Why this robot is not located, and what is off at it, in the words that operators read,
        asked of the server now; empty if it is located and nothing is off. Where no server is
        there, that is what it says.
        """
        if not self.server_alive:
            return self._absent()
        try:
            answer = self._link.query(f"{self._keys.why}?robot={self.name}", timeout_s)
            told = unpack(WhyNot, answer.payload, answer.encoding)
        except (UnreachableError, CodecError) as error:
            return str(error)
        return "; ".join(sentence for sentence in (told.why_not, *told.alarms) if sentence)

    def _absent(self) -> str:
        """Why no server is seen, though a router may be reached."""
        fault = fault_behind_tls(self._session.config_file) if self._link.connected else ""
        return fault or self._no_server() + self._elsewhere()

    def _no_server(self) -> str:
        if not self._link.connected:
            return "no router is reached; what is sent is lost until one is"
        site = self._keys.site
        secured = self._session.config_file is not None
        rules = " Do the router's rules know this robot's certificate?" if secured else ""
        return (
            f"no server at site '{site}': is the site name right, is 'pose-server run' running?"
            + rules
        )

    def _elsewhere(self) -> str:
        """At which other sites there is a server."""
        sites = sorted({site_of(key) for key in self._link.alive(EVERY_SERVER, timeout_s=1.0)})
        return f" There is one at {' and '.join(sites)}." if sites else ""

    @property
    def heard_age_s(self) -> float | None:
        """How long ago the server said that it has the newest view of this robot, or a newer one
        than before, s; None before the first. It grows while views are sent in vain.
        """
        return self._sender.heard_age_s()

    @property
    def unheard_s(self) -> float:
        """For how long views have been sent of which the server has none; 0 where it has them."""
        return self._sender.unheard_s()

    def _is_confirmed(self) -> bool:
        """Whether the server that lives is one that says which views it has."""
        return self._hearing.newest is not None

    def _posed(self, pose: RobotPose) -> None:
        """A pose of a view says as well that the server has it."""
        if pose.robot == self.name and pose.view.epoch == self.epoch:
            self._sender.confirm(pose.view.seq, pose.age_s)

    def _why_unheard(self) -> str:
        """The most probable cause of the server having none of the views that are sent now."""
        if not self._link.connected:
            why = self._session.configuration().why_unreachable()
            return self._no_server() + (f" ({why})" if why else "")
        if not self.server_alive:
            return self._absent()
        heard = self._hearing.newest
        if heard is None:
            try:
                self._link.query(f"{self._keys.why}?robot={self.name}", _ASK_S)
            except UnreachableError as error:
                return (
                    f"a server is there, but not for this robot ({error}): do the router's rules "
                    f"know the name '{self.name}'?"
                )
            return "a server is there, but of an older version that does not say what it hears"
        if unread := unread_by(heard):
            return unread
        if heard.drops:
            counts = "; ".join(f"{reason} {n}" for reason, n in heard.drops.items())
            return f"the server refuses its views: {counts}"
        if heard.epoch != self.epoch:
            return (
                "the server sees that this robot is there, but none of its views: may it publish "
                f"under '{self._keys.cloud(self.name)}'?"
            )
        return f"the server has had no view since number {heard.seq}: the link is slow, or lost"

    def relative_pose(self, other: str, timeout_s: float = 3.0) -> RelativePose:
        """Where another robot is, seen from this one, asked of the server now.

        In the answer `T_a_b`, this robot is a. Act on it only if it is `located`: both robots are,
        and their views are fresh; else `why_not` says why, and the covariance has grown by what
        either may have moved since. `p_grave` is the chance that it is gravely off all the same,
        None where nothing is known of that.

        Raises:
            UnreachableError: there is no server, or no way to tell; the text says why.
            CodecError: the answer is damaged.
        """
        selector = f"{self._keys.relative}?from={self.name};to={checked_name(other)}"
        try:
            answer = self._link.query(selector, timeout_s)
        except UnreachableError as error:
            if self.server_alive:
                raise
            raise UnreachableError(f"{error}: {self._no_server()}") from error
        try:
            return unpack(RelativePose, answer.payload, answer.encoding)
        except CodecError as error:
            self.drops.note(self._keys.relative, error)
            raise

    def flush(self, timeout_s: float = 10.0) -> bool:
        """Waits until everything pushed is on its way; whether it was in time."""
        return self._sender.flush(timeout_s)

    def close(self) -> None:
        """Leaves the fleet; a frame that still waits is dropped, so `flush` if that matters."""
        try:
            self._silence.close()
            self._sender.close()
        finally:
            self._link.close()
            self._poses.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _copied(ranges: Ranges | npt.NDArray[np.floating]) -> Ranges:
    if isinstance(ranges, np.ndarray):
        return DepthImage(np.array(ranges, np.float32))
    if isinstance(ranges, DepthImage):
        return DepthImage(ranges.depth_m.copy(), ranges.step_m)
    if isinstance(ranges, DisparityImage):
        return DisparityImage(
            ranges.disparity_px.copy(), ranges.focal_baseline_px_m, ranges.step_px
        )
    return ScatteredPoints(ranges.uv.copy(), ranges.z.copy())


def _check_up(up_camera: npt.NDArray[np.float64] | None) -> None:
    if up_camera is not None and not abs(np.linalg.norm(up_camera) - 1) < 0.01:
        raise CalibrationError(f"up_camera {np.round(up_camera, 3).tolist()} is no unit vector")


def _check_sizes(frame: Frame) -> None:
    width, height = frame.model.width, frame.model.height
    if frame.image.shape[:2] != (height, width):
        raise CalibrationError(
            f"the image is {frame.image.shape[1]}x{frame.image.shape[0]}, "
            f"the camera {width}x{height}"
        )
    if isinstance(frame.ranges, ScatteredPoints):
        return
    if isinstance(frame.ranges, DepthImage):
        rows, columns = frame.ranges.depth_m.shape
    else:
        rows, columns = frame.ranges.disparity_px.shape
    scale = width // columns if columns else 0
    if (rows * scale, columns * scale) != (height, width):
        raise CalibrationError(
            f"ranges of {columns}x{rows} are no whole fraction of the camera's {width}x{height}"
        )
