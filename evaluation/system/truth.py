"""Where a live robot truly was when it saw a view, for recordings and for the synthetic world."""

import json
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from fleetpose.evaluation.bench.clicks.truth import true_pixels
from fleetpose.evaluation.data.anonymize import StrippedFolder
from fleetpose.evaluation.data.covisibility import Sights, enough_overlap
from fleetpose.evaluation.data.opening import median_depth_m
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.metrics.scoring import OverlapCloud
from fleetpose.evaluation.simulate.operator import by_view_depth
from fleetpose.evaluation.system.observer import SeenView, digest_of
from fleetpose.protocol.clouds import points_of


class Truth(Protocol):
    """What the evaluation knows of a running fleet. Frames: the world's, and the robot's body."""

    @property
    def rgbd(self) -> bool:
        """Whether the limits of RGB-D recordings count."""
        ...

    def median_depth_m(self, seen: Iterable[SeenView]) -> float:
        """Median z over all views' clouds: the recording's, else those seen."""
        ...

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        """(4, 4) true pose of the body at the moment of a view; none if the view is unknown."""
        ...

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        """Pixels (N, 2) of view i and of view j that show the same N points; N may be 0."""
        ...

    def see_the_same(self, i: SeenView, j: SeenView) -> bool:
        """Whether enough of what one view shows is in the other: see `together`."""
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
        self._sights = Sights(recording)
        self._views: dict[_Key, TrueView] = {}
        for robot, folder in folders.items():
            for view, digest in zip(folder.views, _digests(folder), strict=True):
                self._views[_Key(robot, digest)] = view

    @property
    def rgbd(self) -> bool:
        return self._recording.is_rgbd

    def median_depth_m(self, seen: Iterable[SeenView]) -> float:
        del seen
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
        return true_pixels(self._recording, view_i, view_j)

    def see_the_same(self, i: SeenView, j: SeenView) -> bool:
        view_i, view_j = self._view(i), self._view(j)
        return view_i is not None and view_j is not None and self._sights.same(view_i, view_j)

    def _view(self, seen: SeenView) -> TrueView | None:
        return self._views.get(_Key(seen.view.name.robot, seen.digest))


def _digests(folder: StrippedFolder) -> list[str]:
    """What the clouds of a folder's frames look like on the wire, in order."""
    from fleetpose.robot_agent.cameras.factory import open_camera
    from fleetpose.robot_agent.features.packing import cloud_of

    camera = open_camera(folder.camera, str(folder.path), "once")
    return [digest_of(cloud_of(frame.ranges, frame.model)) for frame in camera.frames()]


def _nothing() -> tuple[Floats, Floats]:
    return np.zeros((0, 2)), np.zeros((0, 2))


class WorldTruth:
    """Truth of robots in the synthetic world, from the file that its process writes.

    Args:
        truth_file: written by `evaluation.simulate.world_server`.
        places: the place in the world (r1, r2, ...) of each robot.
    """

    def __init__(self, truth_file: Path, places: Mapping[str, str]) -> None:
        self._file = truth_file
        self._log = Path(f"{truth_file}.log.jsonl")
        self._places = dict(places)
        self._moments: dict[tuple[str, int], Floats] = {}
        self._read_bytes = 0
        self._reading = threading.Lock()  # the operator asks from a thread of its own

    @property
    def rgbd(self) -> bool:
        return False

    def is_there(self) -> bool:
        """Whether the world is up: it writes the file once it listens."""
        return self._file.exists()

    def radius_m(self) -> float:
        """Radius of the ring."""
        return float(self._content()["radius_m"])

    def median_depth_m(self, seen: Iterable[SeenView]) -> float:
        depths = [points_of(one.view).xyz[:, 2] for one in seen]
        return float(np.median(np.concatenate(depths))) if depths else float("nan")

    def T_world_robot(self, seen: SeenView) -> Floats | None:
        place = self._places.get(seen.view.name.robot)
        if place is None:
            return None
        if self._log.exists():
            with self._reading:
                self._read_log()
            return self._moments.get((place, seen.view.stamp_ns))
        return np.array(self._content()["T_world_robots"][place])

    def correspondences(self, i: SeenView, j: SeenView) -> tuple[Floats, Floats]:
        T_i_j = self._T_i_j(i, j)
        return _nothing() if T_i_j is None else by_view_depth(i.view, j.view, T_i_j)

    def see_the_same(self, i: SeenView, j: SeenView) -> bool:
        T_i_j = self._T_i_j(i, j)
        if T_i_j is None:
            return False
        cloud_i, cloud_j = (OverlapCloud.of(points_of(seen.view).xyz) for seen in (i, j))
        return enough_overlap(cloud_i, cloud_j, T_i_j)

    def _T_i_j(self, i: SeenView, j: SeenView) -> Floats | None:
        """(4, 4) true pose of one view's camera in the other's; none if one is unknown."""
        T_world_i, T_world_j = self.T_world_robot(i), self.T_world_robot(j)
        if T_world_i is None or T_world_j is None:
            return None
        T_world_cameras = (
            T_world_i @ i.view.camera.T_robot_camera,
            T_world_j @ j.view.camera.T_robot_camera,
        )
        return inverse(T_world_cameras[0]) @ T_world_cameras[1]

    def _content(self) -> dict[str, Any]:
        return json.loads(self._file.read_text())

    def _read_log(self) -> None:
        """Takes in the lines that were written since the last time."""
        with self._log.open("rb") as log:
            log.seek(self._read_bytes)
            for line in log:
                if not line.endswith(b"\n"):
                    break
                self._read_bytes += len(line)
                entry = json.loads(line)
                moment = (entry["robot"], entry["stamp_ns"])
                self._moments[moment] = np.array(entry["T_world_robot"])
