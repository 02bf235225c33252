"""What the bridge needs of ROS 2, whichever way its topics are reached."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from fleetpose.ros_bridge.outgoing import Types

TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"

Wanted = Callable[[str, str], bool]
"""Whether a topic of a type is to be read."""


class Message(NamedTuple):
    """A message of a robot's topic."""

    topic: str
    type: str
    content: Any


class Topics(Protocol):
    """Topics that are read and written.

    Attributes:
        types: the classes of the messages that are written.
    """

    types: Types

    def take(self, timeout_s: float) -> Message | None:
        """The oldest message that waits, None if none comes in time.

        Raises:
            CodecError: it is damaged.
        """
        ...

    def put(self, topic: str, type: str, message: Any, latched: bool = False) -> None:
        """Sends a message on a topic; `latched`: whoever comes late gets it too."""
        ...
