"""What the user says of a robot that runs; apart from the libraries that reach it."""

from dataclasses import dataclass

from fleetpose.robot_agent.cameras.topics.options import TopicOptions


@dataclass(frozen=True)
class RosOptions(TopicOptions):
    """Attributes:
    domain: ROS_DOMAIN_ID.
    """

    domain: int = 0
