"""Poses of a replay beside those that the recording holds."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, inverse, se3_log
from fleetpose.protocol.messages import RobotPose, ViewName

_CANDIDATES = 500  # each is compared with each


@dataclass(frozen=True)
class Agreement:
    """How far two sets of poses are apart, of the views that both locate.

    Attributes:
        common: views that both locate; and those that only one of both does.
        median_m, max_m, median_deg, max_deg: differences, once the fleet's frames lie on each
            other; none without common views.
        frame_m, frame_deg: by how much they did not.
    """

    common: int
    only_recorded: int
    only_replayed: int
    median_m: float | None = None
    max_m: float | None = None
    median_deg: float | None = None
    max_deg: float | None = None
    frame_m: float | None = None
    frame_deg: float | None = None


def agreement(
    recorded: Mapping[ViewName, RobotPose], replayed: Mapping[ViewName, RobotPose]
) -> Agreement:
    """Compares the last poses told of each view.

    Poses compare within one frame: of each frame of both, all poses are moved by the one of their
    differences that lies in the middle of all.
    """
    here, there = _located(recorded), _located(replayed)
    frames: dict[object, list[Floats]] = defaultdict(list)
    pairs: dict[object, list[tuple[Floats, Floats]]] = defaultdict(list)
    for view in sorted(here.keys() & there.keys(), key=str):
        a, b = here[view], there[view]
        frame = (a.server_epoch, a.gauge_revision, a.component, b.gauge_revision, b.component)
        pairs[frame].append((a.T_fleet_robot, b.T_fleet_robot))
        frames[frame].append(a.T_fleet_robot @ inverse(b.T_fleet_robot))
    common = sum(map(len, pairs.values()))
    counts = common, len(here) - common, len(there) - common
    if not common:
        return Agreement(*counts)
    offsets = {frame: _middle(several) for frame, several in frames.items()}
    apart = [_apart(a, offsets[frame] @ b) for frame, several in pairs.items() for a, b in several]
    metres, degrees = np.array(apart).T
    largest = max(offsets, key=lambda frame: len(pairs[frame]))
    return Agreement(
        *counts,
        float(np.median(metres)),
        float(metres.max()),
        float(np.median(degrees)),
        float(degrees.max()),
        *_apart(offsets[largest], np.eye(4)),
    )


def _located(poses: Mapping[ViewName, RobotPose]) -> dict[ViewName, RobotPose]:
    return {view: pose for view, pose in poses.items() if pose.located}


def _middle(transforms: list[Floats]) -> Floats:
    """The one that is nearest to all others, by where they bring points one metre from the origin:
    one wrong pose moves it nowhere.
    """
    every = len(transforms) // _CANDIDATES + 1
    transforms = transforms[::every]
    corners = np.array([T @ np.array([*axis, 1.0]) for T in transforms for axis in np.eye(3)])
    corners = corners.reshape(len(transforms), -1)
    distances = [np.linalg.norm(corners - one, axis=1).sum() for one in corners]
    return transforms[int(np.argmin(distances))]


def _apart(a: Floats, b: Floats) -> tuple[float, float]:
    """Metres and degrees between two poses (4, 4)."""
    shift = float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
    turn = np.degrees(np.linalg.norm(se3_log(inverse(a) @ b)[:3]))
    return shift, float(turn)
