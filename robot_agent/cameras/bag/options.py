"""What the user says of a bag; apart from the libraries that read it."""

from dataclasses import dataclass
from typing import Literal

StampSource = Literal["header", "receive"]

RGBD_SKEW_MS = 20.0
"""Colour and depth of 30 Hz that are not synchronised are up to half a period apart, 17 ms."""


@dataclass(frozen=True)
class BagOptions:
    """Attributes:
    namespace: of the robot's topics, `/r1`; empty: all.
    image, depth, left, right, cloud: topics, where they are not to be found by type and name.
    base: the frame of the robot's body.
    stamps: whose time counts, the drivers' (`header`) or the recorder's (`receive`).
    speed: how fast it is played; None: frame by frame, each when it is asked for.
    max_skew_ms: what is taken further apart belongs to two moments; None: 20, 10 of two eyes.
    """

    namespace: str = ""
    image: str = ""
    depth: str = ""
    left: str = ""
    right: str = ""
    cloud: str = ""
    base: str = "base_link"
    stamps: StampSource = "header"
    speed: float | None = 1.0
    max_skew_ms: float | None = None
