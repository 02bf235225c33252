"""The map of a site: the keyframes that are located, their clouds, and the links between them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.frontend.frames import body_pose, in_fleet
from fleetpose.pose_server.geometry.se3 import position_covariance
from fleetpose.pose_server.mapping.merging import (
    MOST_SIGMA,
    FleetMap,
    PlacedCloud,
    merge,
    usual_voxel_m,
)
from fleetpose.pose_server.mapping.scene import MapCamera, MapLink, Scene, corners_of
from fleetpose.pose_server.messages.builders import why_misplaced
from fleetpose.pose_server.registration.prepared_view import point_noise
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import KeptView
from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.messages import View, ViewName

Floats = npt.NDArray[np.floating]
Watched = Callable[[Sequence["PlacedView"]], Iterable["PlacedView"]]


class NothingLocatedError(FleetPoseError):
    """There is no map, as no robot is located."""


@dataclass(frozen=True)
class PlacedView:
    """A keyframe that is located.

    Attributes:
        robot: its place in the list of located robots.
        T_fleet_camera: (4, 4).
        covariance: (3, 3) of the camera's position in the fleet frame.
    """

    robot: int
    kept: KeptView
    T_fleet_camera: Floats
    covariance: Floats


def map_of(
    site: Site,
    settings: ServerSettings,
    voxel_m: float | None = None,
    watched: Watched = iter,
) -> Scene:
    """The map of a solved site, of which the covariances of all keyframes are known.

    Args:
        settings: who counts as located.
        voxel_m: edge of a voxel, metres; if not told, what suits the cameras.
        watched: goes through the views, e.g. with a progress bar.

    Raises:
        NothingLocatedError: no robot is located.
        CodecError: a cloud is damaged.
    """
    views = located_views(site, settings)
    names = robots_of(views)
    missing = tuple(name for name in sorted(site.robots) if name not in names)
    if not views:
        raise NothingLocatedError(
            f"none of {len(missing)} robots is located, so there is no map: let robots see the "
            "same, or click the same points in their images; `hmi-client why` says what is missing"
        )
    fleet_map = map_of_views(views, names, site.depth_m, voxel_m, watched)
    return Scene(fleet_map, tuple(_cameras(views)), tuple(_links(site, views)), missing)


def located_views(site: Site, settings: ServerSettings) -> list[PlacedView]:
    """The keyframes of the fleet's own component whose robot would be located there, robot by robot
    in order of their names, the oldest first.
    """
    found: list[PlacedView] = []
    robots = 0
    for _, robot in sorted(site.robots.items()):
        own = [
            view
            for name in robot.track.keyframes
            if (view := _placed(site, settings, name, robots)) is not None
        ]
        found += own
        robots += bool(own)
    return found


def robots_of(views: Iterable[PlacedView]) -> tuple[str, ...]:
    """Names of the robots, each once, in the order that the views count in."""
    return tuple(dict.fromkeys(view.kept.name.robot for view in views))


def map_of_views(
    views: Sequence[PlacedView],
    robots: Sequence[str],
    depth_m: float,
    voxel_m: float | None = None,
    watched: Watched = iter,
) -> FleetMap:
    """The clouds of views in the fleet frame.

    Args:
        views: where they are, of one robot at least.
        robots: names, in the order that the views count in.
        depth_m: median depth of the scene.
        voxel_m, watched: like those of `map_of`.

    Raises:
        CodecError: one is damaged.
    """
    if voxel_m is None:
        voxel_m = float(np.median([_voxel_m(view.kept, depth_m) for view in views]))
    clouds = (cloud_of(view) for view in watched(views))
    return merge(clouds, robots, voxel_m, MOST_SIGMA * depth_m)


def cloud_of(view: PlacedView) -> PlacedCloud:
    """A view's cloud, decoded now.

    Raises:
        CodecError: it is damaged.
    """
    points = points_of(unpack(View, view.kept.payload))
    noise = point_noise(view.kept.camera.noise)
    return PlacedCloud(view.robot, view.T_fleet_camera, points.xyz, noise)


def _placed(site: Site, settings: ServerSettings, name: ViewName, robot: int) -> PlacedView | None:
    """A keyframe where it is, if it may be said to be there."""
    node = None if site.solution is None else site.solution.nodes.get(name)
    kept = site.views.get(name)
    if node is None or kept is None or node.covariance is None:
        return None
    T_fleet_root = site.fleet_from_root(node.root)
    T = body_pose(T_fleet_root, node.T_root_camera, kept.camera.T_robot_camera)
    covariance = in_fleet(T_fleet_root, node.covariance)
    if why_misplaced(site, settings, node, T, covariance, kept.median_depth_m):
        return None
    T_fleet_camera = T_fleet_root @ node.T_root_camera
    return PlacedView(robot, kept, T_fleet_camera, position_covariance(T_fleet_camera, covariance))


def _voxel_m(kept: KeptView, depth_m: float) -> float:
    return usual_voxel_m(depth_m, point_noise(kept.camera.noise), float(kept.camera.K[0, 0]))


def _cameras(views: Sequence[PlacedView]) -> Iterator[MapCamera]:
    """The newest keyframe of each robot, and its way there."""
    for robot in range(len(robots_of(views))):
        own = [view for view in views if view.robot == robot]
        path = np.array([view.T_fleet_camera[:3, 3] for view in own])
        last = own[-1]
        yield MapCamera(
            robot, last.T_fleet_camera, last.covariance, corners_of(last.kept.camera), path
        )


def _links(site: Site, views: Sequence[PlacedView]) -> Iterator[MapLink]:
    """What the solution rests on between two robots: alignments, and clicks that are in none."""
    assert site.solution is not None
    at = {view.kept.name: view.T_fleet_camera[:3, 3] for view in views}
    for edge in site.edges.values():
        judged = site.solution.edges.get(edge.key)
        if edge.a.robot == edge.b.robot or edge.a not in at or edge.b not in at:
            continue
        if judged is not None and judged.weight > 0.0:
            verdict = "ambiguous" if judged.contested else edge.verdict
            yield MapLink(at[edge.a], at[edge.b], verdict, edge.operator)
    for a, b in site.solution.told:
        if a in at and b in at:
            yield MapLink(at[a], at[b], "plausible", True)
