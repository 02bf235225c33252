"""Carries the fleet's poses from the site's router to the topics of ROS 2."""

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError, FleetPoseError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RobotPose
from fleetpose.protocol.transport import Link, Sample
from fleetpose.ros_bridge.fleet_tree import FLEET, MAP, Hung, RobotTree
from fleetpose.ros_bridge.outgoing import Outgoing
from fleetpose.ros_bridge.settings import BridgeSettings
from fleetpose.ros_bridge.topics import ODOMETRY, POSE, TF, Message, Topics, Wanted
from fleetpose.rosmsg.stamps import stamp_ns

log = logging.getLogger("pose-ros")

JOIN_S = 0.1  # between two tellings of where a robot's tree hangs: tf2 looks back ten seconds
_TAKE_S = 0.02
_PART_S = 0.05  # after which a turn ends however much waits
_REPORT_S = 10.0
_KEPT = 100  # stamps of what was said in a robot's own tf: ten seconds


class Bridge:
    """Joins robots' frames under `fleet`, and publishes their poses.

    Args:
        settings: whose topics, and which are written.
        fleet: link to the site.
        topics: gives those of ROS 2, of what is wanted and where drops are counted.
    """

    def __init__(
        self, settings: BridgeSettings, fleet: Link, topics: Callable[[Wanted, Drops], Topics]
    ) -> None:
        self._settings, self._keys = settings, Keys(settings.site)
        self._trees = {name: RobotTree(name, settings.base) for name in settings.robots}
        self._drops = Drops()
        self._poses: queue.SimpleQueue[RobotPose] = queue.SimpleQueue()
        self._ros = topics(self._wants, self._drops)
        self._made = Outgoing(self._ros.types)
        self._joined_s = self._reported_s = 0.0
        self._told: set[str] = set()
        self._said_ns = {name: deque[int](maxlen=_KEPT) for name in settings.map_odom}
        for name in settings.robots:
            fleet.on_latched(self._keys.pose(name), self._store)

    def run(self, stop: threading.Event) -> None:
        """Bridges until it is told to stop."""
        while not stop.is_set():
            self._read()
            while not self._poses.empty():
                self._posed(self._poses.get())
            self._join()
            self._report()

    def _wants(self, topic: str, type: str) -> bool:
        return type in (TF, ODOMETRY) and self._robot_of(topic) is not None

    def _robot_of(self, topic: str) -> str | None:
        """Whose namespace a topic is in."""
        for name, namespace in self._settings.namespaces.items():
            if topic.startswith(f"{namespace}/"):
                return name
        return None

    def _store(self, sample: Sample) -> None:
        """In zenoh's thread."""
        try:
            pose = unpack(RobotPose, sample.payload, sample.encoding)
            if pose.robot not in self._trees or sample.key != self._keys.pose(pose.robot):
                raise CodecError(f"a pose of '{pose.robot}' under another robot's key")
            self._poses.put(pose)
        except FleetPoseError as error:
            self._drops.note(sample.key, error)

    def _read(self) -> None:
        end_s = time.monotonic() + _PART_S
        while time.monotonic() < end_s:
            try:
                message = self._ros.take(_TAKE_S)
                if message is None:
                    return
                self._tell(self._taken(message))
            except FleetPoseError as error:
                self._drops.note("ros", error)

    def _taken(self, message: Message) -> list[Hung]:
        """What of a robot's own frames goes on at once."""
        name = self._robot_of(message.topic)
        if name is None:
            return []
        tree = self._trees[name]
        if message.type == ODOMETRY:
            return tree.take_odometry(message.content)
        if self._is_own(name, message):
            return []
        if not message.topic.endswith("tf_static"):
            return tree.take_tf(message.content, static=False)
        if tree.take_tf(message.content, static=True):
            self._tell_standing()
        return []

    def _is_own(self, name: str, message: Message) -> bool:
        """Whether a robot's tf says what was said in it here: all who listen hear that too."""
        said_ns = self._said_ns.get(name, ())
        return any(
            one.header.frame_id == MAP and stamp_ns(one) in said_ns
            for one in message.content.transforms
        )

    def _posed(self, pose: RobotPose) -> None:
        tree = self._trees[pose.robot]
        if tree.take_pose(pose, time.monotonic()):
            log.info("joined robot=%s frame=%s", pose.robot, tree.named(tree.root))
            self._tell_standing()
        for fault in tree.faults - self._told:
            log.warning("%s", fault)
            self._told.add(fault)
        if not pose.located:
            return
        T, covariance, base = pose.T_fleet_robot, pose.covariance, tree.named(self._settings.base)
        topic = f"/{FLEET}/{pose.robot}"
        made = self._made.pose(FLEET, T, covariance, pose.stamp_ns)
        self._ros.put(f"{topic}/pose", POSE, made)
        made = self._made.odometry(FLEET, base, T, covariance, pose.stamp_ns)
        self._ros.put(f"{topic}/odometry", ODOMETRY, made)

    def _join(self) -> None:
        now_s = time.monotonic()
        if now_s < self._joined_s + JOIN_S:
            return
        self._joined_s = now_s
        joins = {name: tree.joins(now_s) for name, tree in self._trees.items()}
        self._tell([hung for part in joins.values() for hung in part])
        for name in self._settings.map_odom:
            for hung in joins.get(name, []):
                self._tell_map(name, hung)

    def _tell_map(self, name: str, hung: Hung) -> None:
        """The fleet's frame as a robot's map, in the robot's own tf: for Nav2."""
        tree = self._trees[name]
        if tree.maps:
            tree.faults.add(f"{name} has a map of its own: none other is told (--map-odom)")
            return
        if tree.root == self._settings.base:
            tree.faults.add(f"{name} has no odometry that could stand in a map (--map-odom)")
            return
        made = self._made.transform(MAP, tree.root, hung.T_parent_child, hung.stamp_ns)
        self._said_ns[name].append(hung.stamp_ns)
        topic = f"{self._settings.namespaces[name]}/tf"
        self._ros.put(topic, TF, self._made.transforms([made]))

    def _tell(self, hung: Sequence[Hung]) -> None:
        if hung:
            self._ros.put(self._settings.tf, TF, self._message(hung))

    def _tell_standing(self) -> None:
        """All frames that never move, of all who are joined: whoever comes late gets the last."""
        now_s = time.monotonic()
        trees = [tree for tree in self._trees.values() if tree.joins(now_s)]
        if standing := [hung for tree in trees for hung in tree.standing]:
            topic = f"{self._settings.tf}_static"
            self._ros.put(topic, TF, self._message(standing), latched=True)

    def _message(self, hung: Sequence[Hung]) -> Any:
        return self._made.transforms([self._made.transform(*one) for one in hung])

    def _report(self) -> None:
        now_s = time.monotonic()
        if now_s < self._reported_s + _REPORT_S:
            return
        self._reported_s = now_s
        joined = sorted(name for name, tree in self._trees.items() if tree.joins(now_s))
        drops = self._drops.snapshot()
        log.info("joined=%s of=%d drops=%s", ",".join(joined) or "-", len(self._trees), drops)
