"""Where a live robot truly was when it saw a view, for recordings and for the synthetic world."""

from dataclasses import dataclass
from typing import Protocol

from evaluation.datasets import Recording, TrueView, median_depth_m
from evaluation.geometry import Floats, inverse
from evaluation.observer import SeenView, digest_of
from evaluation.operator import by_tracks, by_view_depth
from evaluation.strip import StrippedFolder


class Truth(Protocol):
    """What the evaluation knows of a running fleet. Frames: the world's, and the robot's body."""

    @property
    def rgbd(self) -> bool:
        """Whether the limits of RGB-D recordings count."""
        ...

    def median_depth_m(self) -> float:
        """Median z over all views' clouds."""
        ...

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        """(4, 4) true pose of the body at the moment of a view; none if the view is unknown."""
        ...

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        """Pixels (N, 2) of view i and of view j that show the same N points; N may be 0."""
        ...


@dataclass(frozen=True)
class _Key:
    robot: str
    digest: str


class RecordedTruth:
    """Truth of robots that replay stripped folders: a view is known by the hash of its cloud.

    Args:
        recording: where the folders come from.
        folders: by robot.
    """

    def __init__(self, recording: Recording, folders: dict[str, StrippedFolder]) -> None:
        self._recording = recording
        self._views: dict[_Key, TrueView] = {}
        for robot, folder in folders.items():
            for view, digest in zip(folder.views, _digests(folder), strict=True):
                self._views[_Key(robot, digest)] = view

    @property
    def rgbd(self) -> bool:
        return self._recording.is_rgbd

    def median_depth_m(self) -> float:
        return median_depth_m(self._recording)

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        view = self._view(seen)
        if view is None:
            return None
        return view.T_world_camera @ inverse(seen.view.camera.T_robot_camera)

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        view_i, view_j = self._view(i), self._view(j)
        if view_i is None or view_j is None:
            return _nothing()
        tracks_i, tracks_j = self._recording.tracks(view_i), self._recording.tracks(view_j)
        if tracks_i is not None and tracks_j is not None:
            return by_tracks(*tracks_i, *tracks_j)
        return by_view_depth(i.view, j.view, inverse(view_i.T_world_camera) @ view_j.T_world_camera)

    def _view(self, seen: SeenView) -> TrueView | None:
        return self._views.get(_Key(seen.view.name.robot, seen.digest))


def _digests(folder: StrippedFolder) -> list[str]:
    """What the clouds of a folder's frames look like on the wire, in order."""
    from robot_agent.cameras.factory import open_camera
    from robot_agent.packing import cloud_of

    camera = open_camera(folder.camera, str(folder.path), "once")
    return [digest_of(cloud_of(frame.ranges, frame.model)) for frame in camera.frames()]


def _nothing() -> tuple[Floats, Floats]:
    import numpy as np

    return np.zeros((0, 2)), np.zeros((0, 2))


class WorldTruth:
    """provisional"""

    def __init__(self, truth_file, places):
        self.rgbd = False
