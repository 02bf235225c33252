"""What the user says of a robot's topics; apart from the libraries that read them."""

from dataclasses import dataclass
from typing import Literal

UpSource = Literal["auto", "odom", "imu", "tf", "none"]

RGBD_SKEW_MS = 20.0
"""Colour and depth of 30 Hz that are not synchronised are up to half a period apart, 17 ms."""


@dataclass(frozen=True)
class TopicOptions:
    """Attributes:
    namespace: of the robot's topics, `/r1`; empty: all.
    image, depth, left, right, cloud: topics, where they are not to be found by type and name.
    base: the frame of the robot's body.
    max_skew_ms: what is taken further apart belongs to two moments; None: 20, 10 of two eyes.
    up: what tells where up is.
    """

    namespace: str = ""
    image: str = ""
    depth: str = ""
    left: str = ""
    right: str = ""
    cloud: str = ""
    base: str = "base_link"
    max_skew_ms: float | None = None
    up: UpSource = "auto"
