"""What robots are told of what the server has of them: a robot learns by it alone that its views
arrive, and how fast.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from fleetpose.pose_server.state.robots import Robot
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.codec import schemas_read
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import CameraAnnouncement, Heard, KeptView, Odometry, View
from fleetpose.protocol.messages.base import Message
from fleetpose.protocol.text import release

_SENT_BY_ROBOTS = (View, KeptView, CameraAnnouncement, Odometry)
_READS = tuple(schema for kind in _SENT_BY_ROBOTS for schema in schemas_read(kind))


@dataclass
class Acknowledgements:
    """Publishes `heard/<robot>`.

    Args:
        site: what the server knows.
        keys: of the site.
        epoch: of this life of the server.
        put: publishes a message under a key.
        drops: what was refused, by sender.
    """

    site: Site
    keys: Keys
    epoch: str
    put: Callable[[str, Message], None]
    drops: Drops
    _numbers: dict[str, int] = field(default_factory=dict)

    def tell(self, name: str, arrived_s: float | None = None) -> None:
        """Tells a robot, if it is there, what is here of it.

        Args:
            name: the robot's.
            arrived_s: when its newest view arrived, monotonic; None where none did just now.
        """
        robot = self.site.robots.get(name)
        if robot is not None and robot.alive:
            waited_s = 0.0 if arrived_s is None else max(time.monotonic() - arrived_s, 0.0)
            self.put(self.keys.heard(name), self._heard(robot, waited_s))

    def tell_all(self) -> None:
        """Tells every robot that is there."""
        self._numbers = {name: n for name, n in self._numbers.items() if name in self.site.robots}
        for name in list(self.site.robots):
            self.tell(name)

    def _heard(self, robot: Robot, waited_s: float) -> Heard:
        n = self._numbers[robot.name] = self._numbers.get(robot.name, 0) + 1
        newest = robot.newest
        return Heard(
            robot=robot.name,
            epoch=None if newest is None else newest.epoch,
            seq=None if newest is None else newest.seq,
            waited_s=waited_s,
            drops=self.drops.of(f"robot/{robot.name}"),
            version=release(),
            reads=_READS,
            server_epoch=self.epoch,
            n=n,
        )
