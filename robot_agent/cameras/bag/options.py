"""What the user says of a bag; apart from the libraries that read it."""

from dataclasses import dataclass
from typing import Literal

from fleetpose.robot_agent.cameras.topics.options import TopicOptions

StampSource = Literal["header", "receive"]


@dataclass(frozen=True)
class BagOptions(TopicOptions):
    """Attributes:
    stamps: whose time counts, the drivers' (`header`) or the recorder's (`receive`).
    speed: how fast it is played; None: frame by frame, each when it is asked for.
    """

    stamps: StampSource = "header"
    speed: float | None = 1.0
