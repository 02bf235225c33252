"""The fleet as trajectories and pose graphs: TUM, KITTI and g2o."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fleetpose.formats.g2o import PoseEdge, PoseGraph, write_g2o
from fleetpose.formats.kitti import write_kitti, write_times
from fleetpose.formats.tum import write_tum
from fleetpose.pose_server.geometry.se3 import adjoint, inverse
from fleetpose.pose_server.persistence.placed import Placed, by_component
from fleetpose.pose_server.pose_graph.links import links_of
from fleetpose.pose_server.pose_graph.types import SolveSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import ViewName

Floats = npt.NDArray[np.floating]
_LEAST_SIGMA = np.repeat((1e-5, 1e-5), 3)
"""Radians and metres: a view whose way to its keyframe is known better is the same camera."""


def write_tum_files(placed: dict[ViewName, Placed], folder: Path) -> None:
    """`<component>/<robot>.tum`: robots' bodies, every followed view; poses of different components
    do not compare.
    """
    for component, robots in by_component(placed).items():
        (folder / component).mkdir(parents=True, exist_ok=True)
        for robot, views in robots.items():
            poses = np.array([one.T_fleet_robot for one in views])
            write_tum(folder / component / f"{robot}.tum", stamps_of(views), poses)


def write_kitti_files(placed: dict[ViewName, Placed], folder: Path) -> None:
    """`<component>/<robot>.txt` and `<robot>_times.txt`: robots' cameras, as that benchmark has
    them.
    """
    for component, robots in by_component(placed).items():
        (folder / component).mkdir(parents=True, exist_ok=True)
        for robot, views in robots.items():
            poses = np.array([one.T_fleet_camera for one in views])
            write_kitti(folder / component / f"{robot}.txt", poses)
            write_times(folder / component / f"{robot}_times.txt", stamps_of(views))


def write_g2o_files(site: Site, placed: dict[ViewName, Placed], out: Path) -> int:
    """`fleet.g2o`: the cameras of the anchor's component as one graph, that holds its root still;
    `g2o/<component>.g2o` for each other one, if there are any; and which vertex is which view.
    Returns the count of all edges.
    """
    number = {view: k for k, view in enumerate(placed)}
    edges = list(_edges(site, placed, number))
    own = "" if site.gauge is None else site.component_name(site.gauge)
    components = by_component(placed)
    for component in components:
        views = [one for one in placed.values() if one.component == component]
        ids = {number[one.view] for one in views}
        graph = PoseGraph(
            {number[one.view]: one.T_fleet_camera for one in views},
            [edge for edge in edges if edge.a in ids],
            (number[_root(site, views)],),
        )
        path = out / "fleet.g2o" if component == own else out / "g2o" / f"{component}.g2o"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_g2o(path, graph)
    if own not in components:
        write_g2o(out / "fleet.g2o", PoseGraph({}, []))
    _write_vertices(placed, number, out / "vertices.csv")
    return len(edges)


def stamps_of(views: Sequence[Placed]) -> npt.NDArray[np.int64]:
    """(N,) their times, ns."""
    return np.array([one.followed.stamp_ns for one in views], np.int64)


def _root(site: Site, views: Sequence[Placed]) -> ViewName:
    assert site.solution is not None
    return site.solution.nodes[views[0].followed.keyframe].root


def _edges(
    site: Site, placed: dict[ViewName, Placed], number: dict[ViewName, int]
) -> Iterator[PoseEdge]:
    """The links that the solution rests on, what was clicked, and how views hang on keyframes."""
    if site.solution is None:
        return
    used = [e for e in site.edges.values() if site.solution.edges[e.key].weight > 0.0]
    used = [e for e in used if e.a in number and e.b in number]
    for link in links_of(used, number, SolveSettings.at_depth(site.depth_m)):
        yield PoseEdge(link.a, link.b, link.T_a_b, np.linalg.inv(link.right))
    for (a, b), (_, told) in site.solution.told.items():
        if a in number and b in number:
            yield PoseEdge(number[a], number[b], told.T_a_b, told.upper.T @ told.upper)
    for one in placed.values():
        hung = one.followed
        if not one.is_keyframe and np.isfinite(hung.covariance).all():
            A = adjoint(inverse(hung.T_keyframe_view))
            right = A @ hung.covariance @ A.T + np.diag(_LEAST_SIGMA**2)
            ends = number[hung.keyframe], number[hung.view]
            yield PoseEdge(*ends, hung.T_keyframe_view, np.linalg.inv(right))


def _write_vertices(
    placed: dict[ViewName, Placed], number: dict[ViewName, int], path: Path
) -> None:
    columns = ("vertex", "robot", "epoch", "seq", "stamp_ns", "component", "keyframe", "verdict")
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        for view, one in placed.items():
            hung = one.followed
            named = (number[view], view.robot, view.epoch, view.seq, hung.stamp_ns)
            keyframe = number.get(hung.keyframe, "")
            writer.writerow((*named, one.component, keyframe, hung.verdict))
