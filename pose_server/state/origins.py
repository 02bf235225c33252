"""Which origins the fleet has had."""

from dataclasses import dataclass, field

from fleetpose.protocol.messages import ViewName


@dataclass
class Anchoring:
    """Which origins the fleet has had, and whether it waits for one.

    Attributes:
        asked: the robot that is to be the anchor by the settings.
        origins: earlier ones.
        left_s: since when no robot sees the origin's part of the map while some see each other.
        waits_s: since when robots are there but not the one that is to be the anchor.
        missing: what is said of an anchor that nobody has seen; empty if there is nothing to say.
    """

    asked: str | None = None
    origins: list[ViewName] = field(default_factory=list)
    left_s: float | None = None
    waits_s: float | None = None
    missing: str = ""
