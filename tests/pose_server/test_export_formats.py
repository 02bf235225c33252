"""One fleet is one graph, whatever was clicked where; every followed view is exported."""

from pathlib import Path

import numpy as np
import pytest

from fleetpose.formats.g2o import read_g2o
from fleetpose.formats.kitti import read_kitti, read_times
from fleetpose.formats.reconstructions.bundler import read_bundler
from fleetpose.formats.reconstructions.colmap import read_colmap
from fleetpose.formats.reconstructions.nvm import read_nvm
from fleetpose.formats.reconstructions.photos import Model
from fleetpose.formats.tum import read_tum
from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend import localization
from fleetpose.pose_server.geometry.se3 import inverse, rotation_angle
from fleetpose.pose_server.persistence.export import FORMATS, ExportError, export
from fleetpose.pose_server.persistence.graph_store import Graph, GraphStore
from fleetpose.pose_server.persistence.graph_writer import graph_of
from fleetpose.pose_server.persistence.opening import opened_session
from fleetpose.pose_server.persistence.restore import folder_files
from fleetpose.pose_server.state.site import Site
from tests.pose_server.scene import EPOCH, descriptors, turned, view, walls
from tests.pose_server.test_flows import CORNERS, click, kept, named, work_off

STEPS = 7
T_SCENE_R1 = [turned(5.0 * k) for k in range(STEPS)]
T_SCENE_R2 = turned(10)
MANY = 2000


@pytest.fixture(scope="module")
def walked(tmp_path_factory) -> Path:
    """The state of a server of which r1 walked, farther than its keyframes are kept, and r2 stood;
    the operator clicked in a view of r1 that hangs on a keyframe.
    """
    state = tmp_path_factory.mktemp("walked") / "state"
    rng = np.random.default_rng(4)
    points, looks = walls(rng, MANY), descriptors(rng, MANY)
    journal_file, graph_file = folder_files(state)
    with Journal(journal_file) as journal, pytest.MonkeyPatch.context() as patch:
        patch.setattr(localization, "MOST_KEYFRAMES", 2)
        patch.setattr(localization, "LEAST_KEYFRAMES", 2)
        site = Site(correspondences=CorrespondenceStore(journal))
        for robot in ("r1", "r2"):
            pipeline.receive_token(site, robot, EPOCH, True)
        still = view(rng, "r2", points, looks, inverse(T_SCENE_R2))
        pipeline.receive_view(site, kept(still))
        for k, T in enumerate(T_SCENE_R1):
            pipeline.receive_view(site, kept(view(rng, "r1", points, looks, inverse(T), k)))
            work_off(site)
        track = site.robots["r1"].track
        clicked = next(v for v in reversed(track.attached) if v not in track.keyframes)
        T_view_scene = inverse(T_SCENE_R1[clicked.seq])
        far = [points[np.argmin(np.abs(points[:, :2] - xy).sum(axis=1))] for xy in CORNERS]
        for n, p in enumerate(far, 1):
            at = T_view_scene[:3, :3] @ p + T_view_scene[:3, 3]
            update = click(n, at, T_view_scene @ T_SCENE_R2, view_i=clicked)
            (outcome,) = pipeline.receive_update(site, update)
            assert outcome.accepted, outcome.reason
        work_off(site)
        store = GraphStore(graph_file)
        store.write(Graph(), graph_of(site))
        store.close()
        journal.note(anchor=site.anchor)
    return state


@pytest.fixture(scope="module")
def written(walked, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("out")
    export(walked, out, formats=FORMATS)
    return out


def test_a_clicked_view_hangs_where_it_hung_and_the_fleet_is_one(walked):
    with opened_session(walked) as (site, _):
        clicked = [one for one in site.correspondences.views() if one.robot == "r1"]
        assert clicked and not set(clicked) & set(site.keyframes())
        assert site.solution is not None and len(site.solution.components) == 1


def test_every_followed_view_is_where_it_was_though_its_keyframe_is_gone(walked, written):
    with opened_session(walked) as (site, _):
        assert len(site.robots["r1"].track.keyframes) < 4
    (folder,) = (written / "tum").iterdir()
    stamps, poses = read_tum(folder / "r1.tum")
    _, (still,) = read_tum(folder / "r2.tum")
    assert stamps.tolist() == list(range(STEPS))
    cameras = read_kitti(written / "kitti" / folder.name / "r1.txt")
    (still_camera,) = read_kitti(written / "kitti" / folder.name / "r2.txt")
    times = read_times(written / "kitti" / folder.name / "r1_times.txt")
    assert np.array_equal(times, stamps)
    for T, T_camera, T_true in zip(poses, cameras, T_SCENE_R1, strict=True):
        off = inverse(T_true) @ T_SCENE_R2 @ inverse(inverse(T_camera) @ still_camera)
        assert np.linalg.norm(off[:3, 3]) < 0.15 and rotation_angle(off[:3, :3]) < 0.02
        apart = np.linalg.norm((inverse(still) @ T)[:3, 3])
        assert apart == pytest.approx(np.linalg.norm((inverse(still_camera) @ T_camera)[:3, 3]))


def test_the_graph_is_one_that_others_can_solve(written):
    graph = read_g2o(written / "fleet.g2o")
    assert len(graph.poses) == STEPS + 1 and len(graph.fixed) == 1
    reached, ends = set(graph.fixed), [{edge.a, edge.b} for edge in graph.edges]
    for _ in graph.poses:
        reached |= {k for pair in ends if pair & reached for k in pair}
    assert reached == set(graph.poses)
    for edge in graph.edges:
        assert np.linalg.eigvalsh(edge.information)[0] > 0
        T = inverse(graph.poses[edge.a]) @ graph.poses[edge.b]
        assert np.linalg.norm((inverse(edge.T_a_b) @ T)[:3, 3]) < 0.3
    assert not (written / "g2o").exists()


def reprojected(model: Model) -> np.ndarray:
    parts = []
    for photo in model.photos:
        T = photo.T_camera_world
        p = model.points[photo.seen] @ T[:3, :3].T + T[:3, 3]
        off = photo.focal_px * p[:, :2] / p[:, 2:] - photo.at
        parts.append(off[np.argsort(photo.seen)])  # each format has its own order
    return np.concatenate(parts)


def test_all_reconstructions_say_the_same_and_points_seen_twice_are_one(written):
    colmap = read_colmap(written / "colmap" / "sparse" / "0" / "cameras.bin")
    bundler = read_bundler(written / "bundler" / "bundle.out")
    nvm = read_nvm(written / "nvm" / "fleet.nvm")
    seen = np.bincount(np.concatenate([photo.seen for photo in colmap.photos]))
    assert seen.min() == 1 and (seen > 1).mean() > 0.2
    px = reprojected(colmap)
    assert np.median(np.linalg.norm(px, axis=1)) < 1.5  # half a pixel of noise, and the poses'
    for other in (bundler, nvm):
        assert np.array_equal(other.points, colmap.points)
        order = np.argsort([photo.bare_name for photo in other.photos], kind="stable")
        same = Model(tuple(other.photos[k] for k in order), other.points, other.colours)
        assert np.abs(reprojected(same) - px).max() < 1e-6
    named_there = (written / "bundler" / "list.txt").read_text().split()
    assert f"images/r2_{named(0, 'r2').epoch}_0.jpg" in named_there


def test_an_unknown_format_is_refused_before_anything_is_written(walked, tmp_path):
    with pytest.raises(ExportError, match=r"--formats obj: known are tum,kitti,g2o"):
        export(walked, tmp_path / "none", formats=("tum", "obj"))
    assert not (tmp_path / "none").exists()
