"""Joins the robots' tf trees under one frame `fleet`, after the manner of REP-105.

    fleet -> r1/map -> r1/odom -> r1/base_link     a robot that knows a map
          -> r2/odom -> r2/base_link               one that has odometry only
          -> r3/base_link                          one that tells neither

A robot's own frames keep their pace and their stamps; only where its tree hangs in the fleet moves
when the fleet's solution does. What is not located hangs nowhere, and nothing of it is told.
"""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import RobotPose
from fleetpose.rosmsg.motion.odometry import OdometryReading, Track, odometry_reading
from fleetpose.rosmsg.stamps import stamp_ns
from fleetpose.rosmsg.transforms import Tf, inverse, pose_matrix

Floats = npt.NDArray[np.float64]

FLEET, MAP = "fleet", "map"
SETTLED_S = 2.0
"""For so long a robot's uppermost frame must have been the same before it hangs in the fleet: a
frame that has hung on one parent should not hang on another, and topics are not all found at once.
"""


class Hung(NamedTuple):
    """A frame and where it stands in its parent; names as the fleet's tree has them."""

    parent: str
    child: str
    T_parent_child: Floats
    stamp_ns: int


@dataclass
class RobotTree:
    """One robot's frames and how they hang in the fleet.

    Args:
        name: the robot's in the fleet.
        base: its body's frame, as the robot calls it.

    Attributes:
        faults: why its tree does not hang in the fleet though it is located, once each.
    """

    name: str
    base: str = "base_link"
    faults: set[str] = field(default_factory=set)
    _tf: Tf = field(default_factory=Tf)
    _of_tf: set[str] = field(default_factory=set)  # frames whose parents tf tells
    _static: dict[str, Hung] = field(default_factory=dict)
    _track: Track = field(default_factory=Track)  # of T_root_base
    _tracked: str = ""  # that root
    _newest_ns: int = 0
    _settling: str = ""  # the root at the last pose
    _since_s: float = 0.0  # which it has been the root
    _join: Hung | None = None
    _until_s: float = 0.0

    @property
    def root(self) -> str:
        """The uppermost of its frames, without prefix: of its map, of its odometry, or its
        body's.
        """
        return self._root_of(self._base)

    @property
    def maps(self) -> bool:
        """Whether it knows a map of its own."""
        return any(frame.rpartition("/")[2] == MAP for frame in self._tf.parents.values())

    def take_tf(self, message: Any, static: bool) -> list[Hung]:
        """Takes a `TFMessage` of the robot; what of it is to be told now, as the fleet's tree names
        it: nothing while the robot hangs nowhere.
        """
        self._of_tf |= {_frame(one.child_frame_id) for one in message.transforms}
        return self._take(message, static)

    def take_odometry(self, message: Any) -> list[Hung]:
        """Takes an `Odometry` message; what is to be told of it, unless the robot's tf says the
        same.

        Raises:
            CodecError: its pose is none.
        """
        child = odometry_reading(message).child_frame or self.base
        if child in self._of_tf:
            return []
        pose, parent = message.pose.pose, _frame(message.header.frame_id) or "odom"
        joint = SimpleNamespace(
            header=SimpleNamespace(frame_id=parent, stamp=message.header.stamp),
            child_frame_id=child,
            transform=SimpleNamespace(translation=pose.position, rotation=pose.orientation),
        )
        return self._take(SimpleNamespace(transforms=[joint]), static=False)

    def take_pose(self, pose: RobotPose, now_s: float) -> bool:
        """Takes a pose of the fleet; whether the robot's tree begins to hang in it.

        Args:
            now_s: monotonic; the pose ends when it is no longer valid.
        """
        hung, root = self._join is not None, self.root
        if root != self._settling:
            self._settling, self._since_s = root, now_s
        settled = now_s >= self._since_s + SETTLED_S
        good = settled and pose.located and pose.valid_for_s > 0
        self._join = self._joined(pose) if good else None
        self._until_s = now_s + pose.valid_for_s
        return self._join is not None and not hung

    def joins(self, now_s: float) -> list[Hung]:
        """How the tree hangs in the fleet now, with the stamp of the robot's newest odometry; empty
        while the robot is not located.

        Args:
            now_s: monotonic.
        """
        if self._join is None or now_s > self._until_s:
            self._join = None
            return []
        return [self._join._replace(stamp_ns=max(self._newest_ns, self._join.stamp_ns))]

    @property
    def standing(self) -> list[Hung]:
        """Its frames that never move, as the fleet's tree names them."""
        root = self.root
        return [one for frame, one in self._static.items() if self._root_of(frame) == root]

    def named(self, frame: str) -> str:
        """A frame of the robot as the fleet's tree has it: behind the robot's name, once."""
        frame = _frame(frame)
        return frame if frame.startswith(f"{self.name}/") else f"{self.name}/{frame}"

    @property
    def _base(self) -> str:
        return self._tf.find(self.base, f"{self.name}/") or self.base

    def _root_of(self, frame: str) -> str:
        chain = [frame]
        while (above := self._tf.parents.get(chain[-1])) is not None and above not in chain:
            chain.append(above)
        return chain[-1]

    def _take(self, message: Any, static: bool) -> list[Hung]:
        self._tf.add(message, static)
        hung = {_frame(one.child_frame_id): self._hung(one) for one in message.transforms}
        hung = {frame: one for frame, one in hung.items() if one is not None}
        if static:
            self._static |= hung
        root = self.root
        if root != self._tracked:  # a map appeared above its odometry, or odometry above its body
            self._tracked, self._track, self._join, self._newest_ns = root, Track(), None, 0
        hangs = [one for frame, one in hung.items() if self._root_of(frame) == root]
        T = None if static or not hangs else self._tf.lookup(root, self._base)
        if T is not None:
            self._newest_ns = max(self._newest_ns, hangs[-1].stamp_ns)
            self._track.add(OdometryReading(hangs[-1].stamp_ns, T, None))
        return hangs if self._join is not None else []

    def _joined(self, pose: RobotPose) -> Hung | None:
        """T_fleet_root = T_fleet_robot(t) T_root_robot(t)^-1, t: of the pose's view."""
        T_fleet_robot = np.asarray(pose.T_fleet_robot, np.float64)
        root = self.named(self.root)
        if not self._newest_ns:
            return Hung(FLEET, root, T_fleet_robot, pose.stamp_ns)
        then = self._track.at(pose.stamp_ns)
        if then is None:
            self.faults.add(
                f"{self.name}: its odometry has nothing near the moment of its pose: do its "
                "camera and its odometry go by the same clock?"
            )
            return self._join
        return Hung(FLEET, root, T_fleet_robot @ inverse(then.T_odom_child), pose.stamp_ns)

    def _hung(self, transform: Any) -> Hung | None:
        child, parent = self.named(transform.child_frame_id), self.named(transform.header.frame_id)
        moved = transform.transform
        try:
            T = pose_matrix(moved.translation, moved.rotation)
        except CodecError:
            return None
        return Hung(parent, child, T, stamp_ns(transform))


def _frame(name: Any) -> str:
    return str(name).lstrip("/")
