"""The fleet in 3D: every located robot's points where they are, and nobody else's."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.geometry.icp import has_open3d, open3d
from fleetpose.pose_server.geometry.noise import PointNoise
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.mapping.colours import robot_colours
from fleetpose.pose_server.mapping.files import MapFileError, MapFiles
from fleetpose.pose_server.mapping.located import NothingLocatedError
from fleetpose.pose_server.mapping.merging import (
    FleetMap,
    PlacedCloud,
    merge,
    thinned,
    usual_voxel_m,
)
from fleetpose.pose_server.mapping.picture import draw
from fleetpose.pose_server.mapping.ply import write_map
from fleetpose.pose_server.mapping.projection import Projection, aslant, from_above
from fleetpose.pose_server.mapping.raster import dots
from fleetpose.pose_server.mapping.scene import MapCamera, MapLink, Scene, image_corners
from fleetpose.pose_server.persistence.export import export
from fleetpose.pose_server.persistence.graph_store import Graph, GraphStore
from fleetpose.pose_server.persistence.opening import ExportError
from fleetpose.pose_server.persistence.restore import folder_files
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, View
from tests.pose_server.scene import SIZE, K, descriptors, turned, view, walls

T_TRUE = turned(15)
EXACT = PointNoise(0.5, (0.0, 0.0, 0.0))
PLY_VERTEX = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "u1", 3), ("robot", "<u2")]
)


def read_ply(path: Path) -> tuple[list[str], np.ndarray]:
    """Lines of the header, and the vertices."""
    header, _, rest = path.read_bytes().partition(b"end_header\n")
    return header.decode().splitlines(), np.frombuffer(rest, PLY_VERTEX)


def names_in(header: Sequence[str]) -> list[str]:
    return [line.split()[-1] for line in header if line.startswith("comment robot")]


def places(vertices: np.ndarray, robot: int) -> np.ndarray:
    own = vertices[vertices["robot"] == robot]
    return np.column_stack((own["x"], own["y"], own["z"]))


def state_of(
    folder: Path, views: Sequence[View], edges: Sequence[Edge], anchor: str | None = "r1"
) -> Path:
    """The state folder that a server left."""
    journal_file, graph_file = folder_files(folder)
    keyframes = {message.name: pack(message) for message in views}
    store = GraphStore(graph_file)
    store.write(Graph(), Graph(keyframes, {edge.key: edge for edge in edges}, views[0].name))
    store.close()
    with Journal(journal_file) as journal:
        if anchor is not None:
            journal.note(anchor=anchor)
    return folder


@pytest.fixture
def three(tmp_path) -> tuple[Path, np.ndarray]:
    """A state of three robots of which a link joins the first two, and the true points in the
    frame of the fleet.
    """
    rng = np.random.default_rng(5)
    points, looks = walls(rng, 2000), descriptors(rng, 2000)
    views = [
        view(rng, "r1", points, looks, np.eye(4), noisy=False),
        view(rng, "r2", points, looks, inverse(T_TRUE), noisy=False),
        view(rng, "r3", points, looks, np.eye(4), noisy=False),
    ]
    edge = Edge(views[0].name, views[1].name, T_TRUE, np.eye(6) * 1e-6)
    return state_of(tmp_path / "state", views, [edge]), transform(ROBOT_FROM_CAMERA, points)


def test_points_of_two_robots_are_where_they_are(three, tmp_path):
    state, true = three
    written = export(state, mapped=MapFiles(tmp_path / "map.ply", voxel_m=0.001))
    header, vertices = read_ply(tmp_path / "map.ply")
    assert written.scene is not None and names_in(header) == ["r1", "r2"]
    assert f"element vertex {len(vertices)}" in header
    for robot in (0, 1):
        away, _ = cKDTree(true).query(places(vertices, robot))
        assert len(away) > 1000
        assert away.max() < 0.01  # depths are sent in millimetres


def test_a_robot_that_is_not_located_is_in_no_map_and_is_named(three, tmp_path):
    state, _ = three
    written = export(state, mapped=MapFiles(tmp_path / "map.ply"))
    assert written.scene is not None and written.scene.missing == ("r3",)
    assert "r3" not in names_in(read_ply(tmp_path / "map.ply")[0])
    assert [camera.robot for camera in written.scene.cameras] == [0, 1]
    at = [camera.T_fleet_camera[:3, 3] for camera in written.scene.cameras]
    assert np.linalg.norm(at[1] - at[0]) == pytest.approx(np.linalg.norm(T_TRUE[:3, 3]), abs=1e-3)
    (link,) = written.scene.links
    assert link.verdict == "verified" and np.allclose((link.a, link.b), at)


def test_where_nobody_is_located_nothing_is_written_and_it_is_said_what_to_do(tmp_path):
    rng = np.random.default_rng(6)
    points, looks = walls(rng, 300), descriptors(rng, 300)
    views = [view(rng, robot, points, looks, np.eye(4)) for robot in ("r1", "r2")]
    state = state_of(tmp_path / "state", views, [], anchor=None)
    with pytest.raises(NothingLocatedError, match="hmi-client why"):
        export(state, tmp_path / "out", MapFiles(tmp_path / "map.ply"))
    assert not (tmp_path / "out").exists() and not (tmp_path / "map.ply").exists()


def test_a_robot_whose_place_is_hardly_known_is_in_no_map(tmp_path):
    rng = np.random.default_rng(6)
    points, looks = walls(rng, 300), descriptors(rng, 300)
    views = [view(rng, robot, points, looks, np.eye(4)) for robot in ("r1", "r2")]
    weak = Edge(views[0].name, views[1].name, np.eye(4), np.eye(6) * 100.0)
    scene = export(
        state_of(tmp_path / "state", views, [weak]), mapped=MapFiles(tmp_path / "map.ply")
    ).scene
    assert scene is not None and scene.missing == ("r2",)


def test_what_cannot_be_written_is_said_with_its_option(three, tmp_path):
    state, _ = three
    (tmp_path / "file").write_text("")
    for files, words in (
        (MapFiles(tmp_path / "map.pcd"), "--map .*NAME.ply"),
        (MapFiles(picture=tmp_path / "map.gif"), "--picture .*png"),
        (MapFiles(tmp_path / "map.ply", voxel_m=0.0), "--voxel-m 0"),
        (MapFiles(tmp_path / "map.ply", voxel_m=float("nan")), "--voxel-m nan"),
        (MapFiles(voxel_m=0.1), "--voxel-m goes with"),
        (MapFiles(tmp_path / "file" / "map.ply"), "--map .*file"),
        (MapFiles(picture=tmp_path / "file" / "map.png"), "--picture .*file"),
    ):
        with pytest.raises(MapFileError, match=words):
            export(state, mapped=files)
    with pytest.raises(ExportError, match="--out FOLDER, --map"):
        export(state)
    with pytest.raises(ExportError, match="--state-dir"):
        export(tmp_path / "nothing", mapped=MapFiles(tmp_path / "map.ply"))
    assert not (tmp_path / "map.ply").exists()


def test_the_command_writes_map_and_picture_and_names_who_is_missing(three, tmp_path):
    state, _ = three
    picture = tmp_path / "new" / "map.png"
    command = [
        sys.executable,
        "-P",
        "-m",
        "fleetpose.pose_server",
        "export",
        "--state-dir",
        str(state),
    ]
    options = ["--map", str(tmp_path / "map.ply"), "--picture", str(picture), "--voxel-m", "0.2"]
    done = subprocess.run(
        [*command, *options], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "2 robots, voxels of 0.2 m" in done.stdout and "not in the map: r3" in done.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    refused = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert refused.returncode == 2 and "--map FILE.ply" in refused.stderr


def test_a_map_is_read_by_others(tmp_path):
    if not has_open3d():
        pytest.skip("Open3D needs libraries of the system that are not here")
    rng = np.random.default_rng(1)
    made = a_map(rng.uniform(-5, 5, (40, 3)), rng.integers(0, 2, 40))
    write_map(tmp_path / "map.ply", made)
    read = open3d().io.read_point_cloud(str(tmp_path / "map.ply"))
    assert np.allclose(np.asarray(read.points), made.points, atol=1e-6)
    assert np.allclose(255 * np.asarray(read.colors), robot_colours(2)[made.robot], atol=0.5)


def a_map(points: np.ndarray, robot: np.ndarray) -> FleetMap:
    names = tuple(f"r{k + 1}" for k in range(int(robot.max()) + 1))
    return FleetMap(points.astype(np.float32), robot.astype(np.uint16), names, 0.1)


def test_the_file_says_whose_each_point_is(tmp_path):
    rng = np.random.default_rng(1)
    made = a_map(rng.uniform(-5, 5, (40, 3)), rng.integers(0, 3, 40))
    write_map(tmp_path / "map.ply", made)
    header, vertices = read_ply(tmp_path / "map.ply")
    assert names_in(header) == ["r1", "r2", "r3"] and "property ushort robot" in header
    assert np.array_equal(vertices["robot"], made.robot)
    assert np.array_equal(vertices["rgb"], robot_colours(3)[made.robot])
    assert np.array_equal(np.column_stack([vertices[axis] for axis in "xyz"]), made.points)


def test_points_that_are_known_too_badly_are_left_out():
    points = np.array([(0.0, 0.0, 1.0), (0.0, 0.0, 10.0), (0.0, 0.0, 20.0)])
    noise = PointNoise(0.5, (0.0, 0.0, 0.002))  # 0.2 m at 10 m, 0.8 m at 20 m
    made = merge([PlacedCloud(0, np.eye(4), points, noise)], ["r1"], 0.1, 0.5)
    assert np.allclose(np.sort(made.points[:, 2]), (1.0, 10.0))


def test_a_voxel_holds_the_mean_of_what_a_robot_saw_in_it_and_one_point_of_each_robot():
    rng = np.random.default_rng(2)
    inside = rng.uniform(0.0, 1.0, (50, 3))
    clouds = [PlacedCloud(robot, np.eye(4), inside, EXACT) for robot in (0, 1)]
    made = merge(clouds, ["r1", "r2"], 1.0, 1.0)
    assert np.allclose(made.points, inside.mean(axis=0), atol=1e-6)
    assert made.robot.tolist() == [0, 1]


def test_a_robot_that_sees_the_same_from_two_keyframes_has_it_once():
    rng = np.random.default_rng(3)
    points = rng.uniform(-2.0, 2.0, (500, 3))
    T = turned(40)
    clouds = [
        PlacedCloud(0, np.eye(4), points, EXACT),
        PlacedCloud(0, T, transform(inverse(T), points), EXACT),
    ]
    twice = merge(clouds, ["r1"], 0.5, 1.0).points
    once = merge(clouds[:1], ["r1"], 0.5, 1.0).points
    assert abs(len(twice) - len(once)) <= 1  # but for a point on the border of a voxel
    assert cKDTree(once).query(twice)[0].max() < 0.25


def test_no_voxel_is_occupied_twice():
    points = np.random.default_rng(4).uniform(-3.0, 3.0, (20_000, 3))
    cells = np.floor(thinned(points, 0.5) / 0.5)
    assert len(np.unique(cells, axis=0)) == len(cells) == 12**3


def test_an_empty_cloud_makes_an_empty_map():
    made = merge([PlacedCloud(0, np.eye(4), np.zeros((0, 3)), EXACT)], ["r1"], 0.1, 1.0)
    assert made.points.shape == (0, 3) and made.robot.shape == (0,)


def test_a_voxel_is_no_smaller_than_two_pixels_nor_than_half_the_noise_of_depths():
    assert usual_voxel_m(10.0, EXACT, 500.0) == pytest.approx(2 * 10.0 / 500.0)
    assert usual_voxel_m(10.0, PointNoise(0.5, (0.0, 0.0, 0.002)), 500.0) == pytest.approx(0.1)


def test_the_outline_of_an_ellipsoid_is_what_its_points_reach():
    rng = np.random.default_rng(7)
    root = rng.normal(size=(3, 3))
    projection = aslant(np.stack([ROBOT_FROM_CAMERA]))
    large, small, angle = projection.ellipse(root @ root.T)
    ball = rng.normal(size=(200_000, 3))
    surface = (ball / np.linalg.norm(ball, axis=1, keepdims=True)) @ root.T
    a = np.radians(angle)
    along = projection.flat(surface) @ np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    reach = np.linalg.norm(along / (large, small), axis=1)
    assert reach.max() == pytest.approx(1.0, abs=1e-3) and reach.max() <= 1.0 + 1e-9


@pytest.mark.parametrize("yaws_deg", [(0.0, 20.0), (0.0, 120.0, 240.0)])
def test_a_slanted_view_keeps_lengths_and_shows_what_is_above_above(yaws_deg):
    around = [turned(yaw, 0.0) for yaw in yaws_deg]
    axes = aslant(np.stack([ROBOT_FROM_CAMERA @ T for T in around])).axes
    assert np.allclose(axes @ axes.T, np.eye(3)) and np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[1, 2] > 0.5 and axes[0, 2] == pytest.approx(0.0)


def test_cameras_that_look_one_way_are_seen_from_behind():
    looks_ahead = np.stack([ROBOT_FROM_CAMERA])
    assert aslant(looks_ahead).axes[2, 0] < -0.5  # who looks stands at the back


def test_the_nearest_point_is_in_front():
    places_2d, nearness = np.array([(0.5, 0.5), (0.5, 0.5)]), np.array([2.0, 1.0])
    colours = np.array([(1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])
    box = np.array([(0.0, 0.0), (1.0, 1.0)])
    image = dots(places_2d, nearness, colours, box, (9, 9), haze=0.0)
    assert image[4, 4].tolist() == [255, 0, 0, 255] and image[0, 8, 3] == 0


def test_points_beside_the_picture_are_not_drawn():
    box = np.array([(0.0, 0.0), (1.0, 1.0)])
    away = np.array([(-0.1, 0.5), (0.5, 1.2)])
    assert not dots(away, np.zeros(2), np.ones((2, 3)), box, (9, 9), 0.5).any()


@pytest.mark.parametrize("count", [1, 8, 10, 11, 72, 1000])
def test_robots_have_colours_of_their_own(count):
    colours = robot_colours(count)
    assert colours.shape == (count, 3)
    assert len(np.unique(colours, axis=0)) == count or count > 500


@pytest.mark.parametrize("ending", ["png", "svg"])
@pytest.mark.parametrize("points", [0, 500])
def test_a_picture_is_drawn_also_of_one_robot_and_of_no_points(tmp_path, ending, points):
    rng = np.random.default_rng(8)
    corners = image_corners(K, *SIZE)
    assert np.allclose(corners.mean(axis=0), (-0.5 / 600, -0.5 / 600, 1.0))
    camera = MapCamera(0, ROBOT_FROM_CAMERA, np.eye(3) * 1e-4, corners, np.zeros((1, 3)))
    made = a_map(rng.uniform(1, 5, (points, 3)), np.zeros(max(points, 1), int))
    made = FleetMap(made.points, made.robot[:points], made.robots, made.voxel_m)
    link = MapLink(np.zeros(3), np.ones(3), "ambiguous", True)
    path = tmp_path / f"map.{ending}"
    draw(Scene(made, (camera,), (link,), ("r2",) * 9), path, "one robot")
    assert path.stat().st_size > 10_000


def test_from_above_x_is_to_the_right_and_y_up():
    above: Projection = from_above()
    assert np.array_equal(above.flat(np.array([(1.0, 2.0, 3.0)])), [(1.0, 2.0)])
