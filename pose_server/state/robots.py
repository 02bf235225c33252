"""A robot as the server knows it: its life signs and its track."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.tracks import Track
from fleetpose.pose_server.pose_graph.types import NodePose
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.messages import Camera, RobotPose, ViewName

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class PublishedAt:
    """Where a published pose hung: its keyframe, where that stood in the graph and in the fleet
    frame (4, 4).
    """

    keyframe: ViewName
    node: NodePose
    T_fleet_keyframe: Floats


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
        published: the pose that was told last, and where that put it.
        stood: the first view since which it has stood still and seen the same.
        refused: how many of its views were refused since the newest one, and why the last was.
        blind: the text of the alarm that its newest view has hardly any depth; empty if it has.
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
    published_at: PublishedAt | None = None
    stood: KeptView | None = None
    refused: tuple[int, str] = (0, "")
    blind: str = ""

    @property
    def alive(self) -> bool:
        """Whether its token is there."""
        return bool(self.epochs)

    @property
    def epoch(self) -> str | None:
        """Of its present life, None while its token is not there."""
        return self.epochs[-1] if self.epochs else None

    @property
    def poses_sent(self) -> int:
        """How many poses of it were told."""
        return 0 if self.published is None else self.published.n

    def note_token(self, epoch: str, alive: bool) -> None:
        """A token is there, or is gone."""
        self.epochs = [known for known in self.epochs if known != epoch]
        if alive:
            self.epochs.append(epoch)
        else:
            self.refused = (0, "")

    def arrive(self, view: ViewName) -> None:
        """A view is its newest one; it waits to be followed."""
        self.newest = self.waiting = view
        self.refused = (0, "")

    def refuse(self, reason: str) -> None:
        """A view of it could not be used."""
        self.refused = (self.refused[0] + 1, reason)

    def note_camera(self, view: KeptView, changes: int) -> None:
        """Calibration and clock are those of a view, in so many things others than before."""
        self.camera, self.stamp_ns = view.camera, view.stamp_ns
        self.changes += changes

    def note_blind(self, text: str) -> None:
        """Its newest view has hardly any depth, as the text says; or has again, if it is empty."""
        self.blind = text

    def stand_since(self, view: KeptView) -> None:
        """It has stood still and seen the same since a view."""
        self.stood = view

    def wait(self, view: ViewName | None) -> None:
        """A view is to be followed next, or none is."""
        self.waiting = view

    def want_past(self, view: ViewName, first: bool = False) -> None:
        """An older view is to be followed as well."""
        self.past_queue.insert(0 if first else len(self.past_queue), view)

    def next_past(self) -> ViewName | None:
        """Takes the older view whose turn it is, if none is at work."""
        if self.past_in_flight is not None or not self.past_queue:
            return None
        return self.past_queue.pop(0)

    def follow(self, view: ViewName) -> None:
        """A worker is at a view."""
        if view in self.track.past:
            self.past_in_flight = view
        else:
            self.tracking = view

    def followed(self, view: ViewName) -> None:
        """A worker has ended with a view."""
        if view in self.track.past:
            self.past_in_flight = None
        else:
            self.tracking = None

    def publish(self, pose: RobotPose, at: PublishedAt | None = None) -> None:
        """A pose was told; where it hung, unless that is as before."""
        self.published, self.published_at = pose, at or self.published_at
