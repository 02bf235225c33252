"""A session as files, and its map: what `pose-server export` writes."""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import gtsam
import numpy as np
import numpy.typing as npt

from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.frontend.frames import body_pose
from fleetpose.pose_server.geometry.se3 import quat_wxyz
from fleetpose.pose_server.mapping.files import MapFiles
from fleetpose.pose_server.mapping.located import Watched, map_of
from fleetpose.pose_server.mapping.scene import Scene
from fleetpose.pose_server.persistence.opening import ExportError, opened_session
from fleetpose.pose_server.persistence.table import write_csv, write_json
from fleetpose.pose_server.pose_graph import factors as gt
from fleetpose.pose_server.pose_graph.links import links_of
from fleetpose.pose_server.pose_graph.types import SolveSettings
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.messages import KeptView, View, ViewName

Floats = npt.NDArray[np.floating]
VIEWS = "views"
VIEW_ENDING = ".view"
README = """What a fleetpose server knew, as `pose-server export` wrote it.

correspondences.json, .csv  points that operators clicked in two images: pixels, and the points in
                            the camera frames of their views, metres
fleet.g2o                   pose graph of the cameras: VERTEX_SE3:QUAT, EDGE_SE3:QUAT with the
                            information matrix (gtsam's order of tangent vectors); links that were
                            found wrong are left out, clicks between two views are one edge
keyframes.csv               which vertex is which view
trajectories/<component>/   robots' bodies in the fleet frame, one TUM file per robot:
                            time tx ty tz qx qy qz qw, by the robot's clock
views/                      the views that were clicked in, for `pose-server import`, and images
"""


@dataclass(frozen=True)
class Exported:
    """How much was written.

    Attributes:
        scene: the map, if one was asked for.
    """

    correspondences: int = 0
    keyframes: int = 0
    links: int = 0
    components: int = 0
    views: int = 0
    scene: Scene | None = None


def export(
    state_dir: Path,
    out: Path | None = None,
    mapped: MapFiles = MapFiles(),  # noqa: B008 (frozen)
    watched: Watched = iter,
) -> Exported:
    """Writes the session of a state folder, its map, or both; its server may be running.

    Nothing is written where a map is asked for that there cannot be.

    Args:
        out: folder for the session.
        mapped: files for the map.
        watched: goes through the views of the map, e.g. with a progress bar.

    Raises:
        FleetPoseError: there is no session, it cannot be read, no robot is located, or a file or
            the folder not be written.
    """
    mapped.check()
    if out is None and not mapped.wanted:
        raise ExportError("say what to write: --out FOLDER, --map FILE.ply or --picture FILE.png")
    with opened_session(state_dir) as (site, journal):
        scene = None
        if mapped.wanted:
            settings = ServerSettings.model_validate({})
            scene = map_of(site, settings, mapped.voxel_m, watched)
            mapped.write(scene)
        if out is None:
            return Exported(scene=scene)
        try:
            return replace(_written(site, journal, out), scene=scene)
        except OSError as error:
            raise ExportError(f"--out {out}: {error.strerror or error}") from error


def _written(site: Site, journal: Journal, out: Path) -> Exported:
    out.mkdir(parents=True, exist_ok=True)
    (out / "README.txt").write_text(README)
    items = site.correspondences.all()
    write_json(out / "correspondences.json", items, anchor=site.anchor)
    write_csv(out / "correspondences.csv", items)
    links = _write_graph(site, out)
    components = _write_trajectories(site, out / "trajectories")
    views = _write_views(journal, site.correspondences.views(), out / VIEWS)
    return Exported(len(items), len(site.keyframes()), links, components, views)


def _write_graph(site: Site, out: Path) -> int:
    """The cameras of all keyframes, component by component, and the links that hold them."""
    solution = site.solution
    names = [] if solution is None else [v for c in solution.components.values() for v in c]
    number = {view: k for k, view in enumerate(names)}
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    edges = []
    if solution is not None:
        for view, k in number.items():
            values.insert(k, gtsam.Pose3(solution.nodes[view].T_root_camera))
        edges = [e for e in site.edges.values() if solution.edges[e.key].weight > 0.0]
        settings = SolveSettings.at_depth(site.depth_m)
        for link in links_of(edges, number, settings):
            graph.push_back(gt.between(link))
        for (a, b), (_, summary) in solution.told.items():
            graph.push_back(gt.click_factor(number[a], number[b], summary))
    gtsam.writeG2o(graph, values, str(out / "fleet.g2o"))
    with (out / "keyframes.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("vertex", "robot", "epoch", "seq", "stamp_ns", "component", "verdict"))
        for view, k in number.items():
            assert solution is not None
            node = solution.nodes[view]
            component = site.component_name(node.root)
            stamp_ns = site.views[view].stamp_ns
            writer.writerow(
                (k, view.robot, view.epoch, view.seq, stamp_ns, component, node.verdict)
            )
    return graph.size()


def _write_trajectories(site: Site, folder: Path) -> int:
    """One file per robot and component: poses of different components do not compare."""
    if site.solution is None:
        return 0
    lines: dict[Path, list[tuple[int, str]]] = {}
    for view, node in site.solution.nodes.items():
        kept = site.views[view]
        T_fleet_root = site.fleet_from_root(node.root)
        T = body_pose(T_fleet_root, node.T_root_camera, kept.camera.T_robot_camera)
        path = folder / site.component_name(node.root) / f"{view.robot}.tum"
        lines.setdefault(path, []).append((kept.stamp_ns, tum_line(kept.stamp_ns, T)))
    for path, own in lines.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(f"{line}\n" for _, line in sorted(own)))
    return len(site.solution.components)


def tum_line(stamp_ns: int, T: Floats) -> str:
    """`timestamp tx ty tz qx qy qz qw` of a pose (4, 4), seconds and metres."""
    w, x, y, z = quat_wxyz(T[:3, :3])
    numbers = " ".join(f"{value:.9f}" for value in (*T[:3, 3], x, y, z, w))
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {numbers}"


def _write_views(journal: Journal, clicked: set[ViewName], folder: Path) -> int:
    stored = [view for view in journal.views() if view.name in clicked]
    for view in stored:
        folder.mkdir(parents=True, exist_ok=True)
        kept = KeptView(view=unpack(View, view.encoded), jpeg=view.jpeg, image=view.header)
        view_file(folder, view.name).write_bytes(pack(kept))
        if view.jpeg is not None:
            view_file(folder, view.name).with_suffix(".jpg").write_bytes(view.jpeg)
    return len(stored)


def view_file(folder: Path, view: ViewName) -> Path:
    """Where a view is kept in an exported folder."""
    return folder / f"{view.robot}_{view.epoch}_{view.seq}{VIEW_ENDING}"
