"""Where the points of a place truly are, and a fleet's frame in the world."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.data.opening import open_recording, points_of
from fleetpose.evaluation.data.recording import Recording, TrueView
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.mapping.located import PlacedView, cloud_of

Floats = npt.NDArray[np.floating]


@dataclass(frozen=True)
class TrueCloud:
    """Points (N, 3) in the world, and what they are in words."""

    points: Floats
    what: str


def world_from_fleet(
    views: Sequence[PlacedView], true: Mapping[str, TrueView], anchor: str | None
) -> Floats:
    """T_world_fleet with which the anchor's camera stands where it truly stands."""
    view = next(view for view in views if view.kept.name.robot == anchor)
    assert anchor is not None
    return true[anchor].T_world_camera @ inverse(view.T_fleet_camera)


def at_true_poses(
    views: Sequence[PlacedView], true: Mapping[str, TrueView], T_world_fleet: Floats
) -> list[PlacedView]:
    """The same views, where they truly are in the fleet's frame."""
    T_fleet_world = inverse(T_world_fleet)
    return [
        replace(view, T_fleet_camera=T_fleet_world @ true[view.kept.name.robot].T_world_camera)
        for view in views
    ]


def true_cloud(
    recording: Recording,
    seen: Sequence[TrueView],
    views: Sequence[PlacedView],
    true: Mapping[str, TrueView],
) -> TrueCloud:
    """The true points that the views of located robots see.

    Args:
        seen: the true views of the located robots.
        views: the same as the server places them; their clouds are taken where a recording has no
            `sparse` clouds.
    """
    if not recording.is_rgbd and (recording.directory / "sparse").is_dir():
        sparse = open_recording(recording.directory, "sparse")
        clouds = [
            transform(view.T_world_camera, points_of(sparse.view(view.index))[1]) for view in seen
        ]
        return TrueCloud(np.concatenate(clouds), "those of `sparse`, without the robots' noise")
    clouds = [
        transform(true[view.kept.name.robot].T_world_camera, cloud_of(view).points)
        for view in views
    ]
    return TrueCloud(np.concatenate(clouds), "the robots' own clouds, with their noise")
