"""A robot as the server knows it: its life signs and its track."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.tracks import Track
from fleetpose.pose_server.pose_graph.types import NodePose
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.messages import Camera, PairError, RobotPose, ViewName

Floats = npt.NDArray[np.floating]


@dataclass
class Robot:
    """One robot: its life signs and its track.

    Attributes:
        epochs: of the tokens that are there now, the last one is the one that counts.
        newest: the newest view received.
        waiting: the newest view that is not tracked yet.
        tracking: the view that a worker follows at present.
        past_queue: older views that somebody looks at and that hang nowhere yet.
        past_in_flight: the one of these that a worker is at.
        camera: of the newest view.
        stamp_ns: of the newest view, by the robot's clock.
        changes: of calibration, and times that the clock went back.
        errors: of its pairs as they are told; None when one of them changed.
        stood: the first view since which it has stood still and seen the same.
    """

    name: str
    epochs: list[str] = field(default_factory=list)
    newest: ViewName | None = None
    waiting: ViewName | None = None
    tracking: ViewName | None = None
    past_queue: list[ViewName] = field(default_factory=list)
    past_in_flight: ViewName | None = None
    camera: Camera | None = None
    stamp_ns: int = 0
    changes: int = 0
    track: Track = field(default_factory=Track)
    published: RobotPose | None = None
    published_keyframe: tuple[ViewName, Floats] | None = None
    published_node: NodePose | None = None
    errors: tuple[PairError, ...] | None = None
    poses_sent: int = 0
    untracked: int = 0
    stood: KeptView | None = None

    @property
    def alive(self) -> bool:
        """Whether its token is there."""
        return bool(self.epochs)

    @property
    def epoch(self) -> str | None:
        """Of its present life, None while its token is not there."""
        return self.epochs[-1] if self.epochs else None
