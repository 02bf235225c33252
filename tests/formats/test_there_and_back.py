"""What is written in a format is read as it was, whatever it was; what others wrote is read too."""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.formats.arrays import FormatError
from fleetpose.formats.g2o import PoseEdge, PoseGraph, read_g2o, write_g2o
from fleetpose.formats.kitti import read_kitti, read_times, write_kitti, write_times
from fleetpose.formats.ply import read_ply, write_ply
from fleetpose.formats.reconstructions.bundler import read_bundler, write_bundler
from fleetpose.formats.reconstructions.colmap import read_colmap, write_colmap
from fleetpose.formats.reconstructions.nvm import opencvs, read_nvm, write_nvm
from fleetpose.formats.reconstructions.photos import Model, Photo
from fleetpose.formats.rotations import pose_of, quat_wxyz
from fleetpose.formats.tum import read_tum, write_tum
from tests.data import shared_data

SIZE = (640, 480)
MIDDLE = (np.array(SIZE) - 1) / 2
SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=25, deadline=None)
KINDS = ("text", "binary", "bundler", "nvm")


@pytest.fixture(scope="module")
def folder():
    with tempfile.TemporaryDirectory() as name:
        yield Path(name)


def random_pose(rng: np.random.Generator, metres: float = 10.0) -> np.ndarray:
    """Anywhere, also at half turns, where quaternions are delicate."""
    q = rng.normal(size=4) * (rng.random(4) < 0.7)
    return pose_of(q if q.any() else np.array([0.0, 1.0, 0.0, 0.0]), rng.normal(0, metres, 3))


def random_model(seed: int, photos: int = 4, distorted: bool = False) -> Model:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 5, (int(rng.integers(1, 40)), 3))
    made = []
    for k in range(photos):
        seen = np.flatnonzero(rng.random(len(points)) < 0.6)
        at = rng.uniform(-300, 300, (len(seen), 2))
        distortion = np.array([rng.normal(0, 0.05), rng.normal(0, 0.01), 0, 0]) * distorted
        f = rng.uniform(300, 900)
        T = random_pose(rng)
        made.append(Photo(f"r{k}.jpg", np.array([f, f]), distortion, T, seen, at, MIDDLE, SIZE))
    return Model(tuple(made), points, rng.integers(0, 256, points.shape).astype(float))


def through(folder: Path, kind: str, model: Model) -> Model:
    """Written and read again."""
    if kind == "bundler":
        write_bundler(folder / "bundle.out", model)
        return read_bundler(folder / "bundle.out")
    if kind == "nvm":
        write_nvm(folder / "model.nvm", model)
        return read_nvm(folder / "model.nvm")
    write_colmap(folder, model, binary=kind == "binary")
    return read_colmap(folder / ("cameras.bin" if kind == "binary" else "cameras.txt"))


def off_px(model: Model) -> np.ndarray:
    """(M, 2) how far all points are seen from where they project, without distortion."""
    parts = []
    for photo in model.photos:
        T = photo.T_camera_world
        p = model.points[photo.seen] @ T[:3, :3].T + T[:3, 3]
        parts.append(photo.focal_px * p[:, :2] / p[:, 2:] - photo.at)
    return np.concatenate(parts)


@pytest.mark.parametrize("kind", KINDS)
@FEW
@given(seed=SEEDS)
def test_reconstructions_come_back_and_project_where_they_did(folder, kind, seed):
    model = random_model(seed)
    back = through(folder, kind, model)
    assert np.array_equal(back.points, model.points)
    assert np.array_equal(back.colours, model.colours)
    for before, after in zip(model.photos, back.photos, strict=True):
        assert after.name == before.name and np.array_equal(after.seen, before.seen)
        assert np.allclose(after.T_camera_world, before.T_camera_world, atol=1e-12)
        assert np.allclose(after.focal_px, before.focal_px, rtol=1e-14)
    size = 1 + np.abs(off_px(model))  # points may lie near a camera's plane
    assert (np.abs(off_px(back) - off_px(model)) / size).max(initial=0.0) < 1e-6


@pytest.mark.parametrize("kind", ("text", "binary", "bundler"))
@FEW
@given(seed=SEEDS)
def test_distortion_comes_back(folder, kind, seed):
    model = random_model(seed, distorted=True)
    for before, after in zip(model.photos, through(folder, kind, model).photos, strict=True):
        assert np.array_equal(before.distortion, after.distortion)


@FEW
@given(st.floats(-0.2, 0.2))
def test_visualsfms_own_distortion_comes_back(folder, d):
    photo = random_model(0).photos[0]
    bent = Photo(photo.name, photo.focal_px, opencvs(d), *(np.eye(4), photo.seen, photo.at))
    model = Model((bent,), random_model(0).points, random_model(0).colours)
    (back,) = through(folder, "nvm", model).photos
    assert np.allclose(back.distortion, bent.distortion, atol=1e-15)


def test_colmap_counts_pixels_from_the_corner_and_bundler_from_the_middle_upwards(tmp_path):
    """By hand: a point a pixel right of and below the axis of a camera of 101x81 pixels."""
    at, T = np.array([[1.0, 1.0]]), pose_of(np.array([1.0, 0, 0, 0]), np.zeros(3))
    photo = Photo("a.jpg", np.array([100.0, 100.0]), np.zeros(4), T, np.array([0]), at)
    photo = replace(photo, centre=np.array([50.0, 40.0]), size=(101, 81))
    model = Model((photo,), np.array([[0.1, 0.1, 10.0]]), np.full((1, 3), 7.0))
    write_colmap(tmp_path, model)
    assert "1 PINHOLE 101 81 100.0 100.0 50.5 40.5" in (tmp_path / "cameras.txt").read_text()
    images = (tmp_path / "images.txt").read_text().splitlines()
    assert images[-2:] == ["1 1.0 0.0 0.0 0.0 0.0 0.0 0.0 1 a.jpg", "51.5 41.5 1"]
    assert (tmp_path / "points3D.txt").read_text().splitlines()[-1] == (
        "1 0.1 0.1 10.0 7 7 7 0.0 1 0"
    )
    write_bundler(tmp_path / "bundle.out", model)
    lines = (tmp_path / "bundle.out").read_text().splitlines()
    assert lines[1:3] == ["1 1", "100.0 0.0 0.0"]
    R = np.array([line.split() for line in lines[3:6]], float)
    assert np.array_equal(R, np.diag([1, -1, -1]))  # y up, and it looks down -z
    assert lines[-1] == "1 0 0 1.0 -1.0"


@pytest.mark.parametrize("kind", ("bundler", "nvm"))
def test_what_a_format_cannot_say_is_refused(tmp_path, kind):
    model = random_model(1)
    oblong = replace(model.photos[0], focal_px=np.array([500.0, 520.0]))
    with pytest.raises(FormatError, match="not square"):
        through(tmp_path, kind, Model((oblong,), model.points, model.colours))
    bent = replace(model.photos[0], distortion=np.array([0.1, 0, 0.1, 0]))
    with pytest.raises(FormatError, match="undistort"):
        through(tmp_path, kind, Model((bent,), model.points, model.colours))
    named = replace(model.photos[0], name="a\nb.jpg")
    with pytest.raises(FormatError, match="name"):
        through(tmp_path, kind, Model((named,), model.points, model.colours))


def test_kermit_by_bundler_there_and_back_is_as_good_as_it_was(tmp_path):
    folder = shared_data("bundler_kermit")
    model = read_bundler(next(folder.rglob("bundle.out")))
    undistorted = Model(
        tuple(replace(p, distortion=np.zeros(4)) for p in model.photos if len(p.seen)),
        model.points,
        model.colours,
    )
    again = through(tmp_path, "bundler", undistorted)
    assert np.abs(off_px(again) - off_px(undistorted)).max() < 1e-6


@FEW
@given(seed=SEEDS, count=st.integers(0, 6))
def test_trajectories_come_back(folder, seed, count):
    rng = np.random.default_rng(seed)
    poses = np.array([random_pose(rng) for _ in range(count)]).reshape(-1, 4, 4)
    stamps_ns = rng.integers(0, 2**62, count)
    write_tum(folder / "a.tum", stamps_ns, poses)
    back_ns, back = read_tum(folder / "a.tum")
    assert np.array_equal(back_ns, stamps_ns) and np.allclose(back, poses, atol=1e-12)
    write_kitti(folder / "a.txt", poses)
    assert np.array_equal(read_kitti(folder / "a.txt"), poses)
    write_times(folder / "times.txt", stamps_ns)
    assert np.array_equal(read_times(folder / "times.txt"), stamps_ns)


@FEW
@given(seed=SEEDS, half_angles=st.booleans())
def test_pose_graphs_come_back(folder, seed, half_angles):
    rng = np.random.default_rng(seed)
    poses = {int(k): random_pose(rng) for k in rng.choice(2**50, 5, replace=False)}
    roots = rng.normal(size=(4, 6, 6))
    keys = list(poses)
    edges = [PoseEdge(*rng.choice(keys, 2), random_pose(rng), root @ root.T) for root in roots]
    write_g2o(folder / "a.g2o", PoseGraph(poses, edges, (keys[0],)), half_angles)
    back = read_g2o(folder / "a.g2o", half_angles)
    assert list(back.poses) == keys and back.fixed == (keys[0],)
    assert all(np.allclose(back.poses[k], poses[k], atol=1e-12) for k in keys)
    for a, b in zip(edges, back.edges, strict=True):
        assert (a.a, a.b) == (b.a, b.b) and np.allclose(a.T_a_b, b.T_a_b, atol=1e-12)
        assert np.allclose(a.information, b.information, rtol=1e-14, atol=0)


def g2os_error(T_measured: np.ndarray, T_a_b: np.ndarray) -> np.ndarray:
    """(6,) as g2o's EdgeSE3 has it: translation and quaternion's vector part of what is between."""
    between = np.linalg.inv(T_measured) @ T_a_b
    return np.array([*between[:3, 3], *quat_wxyz(between[:3, :3])[1:]])


@FEW
@given(seed=SEEDS)
def test_g2os_own_sum_of_squares_is_that_of_the_information(folder, seed):
    """Half-angle blocks by numerical differentiation of g2o's error."""
    rng = np.random.default_rng(seed)
    T, root = random_pose(rng), rng.normal(size=(6, 6))
    information = root @ root.T
    write_g2o(folder / "b.g2o", PoseGraph({0: T, 1: T}, [PoseEdge(0, 1, T, information)]))
    (edge,) = [x for x in (folder / "b.g2o").read_text().splitlines() if x.startswith("EDGE")]
    upper = np.zeros((6, 6))
    upper[np.triu_indices(6)] = list(map(float, edge.split()[10:]))
    written = upper + np.triu(upper, 1).T
    step, jacobian = 1e-6, np.zeros((6, 6))
    for k in range(6):
        xi = np.eye(6)[k] * step
        small = pose_of(np.array([1.0, *(xi[:3] / 2)]), xi[3:])
        jacobian[:, k] = g2os_error(T, T @ small) / step
    assert np.allclose(jacobian.T @ written @ jacobian, information, rtol=1e-5, atol=1e-5)


@FEW
@given(seed=SEEDS, count=st.integers(0, 20))
def test_points_come_back_with_all_their_fields(folder, seed, count):
    rng = np.random.default_rng(seed)
    kinds = ["i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8"]
    dtype = np.dtype([(f"p{k}", kind) for k, kind in enumerate(kinds)])
    vertices = np.zeros(count, dtype)
    for name in dtype.names:
        vertices[name] = rng.integers(0, 127, count)
    write_ply(folder / "a.ply", vertices, ("metres", "robot 0 r1"))
    back = read_ply(folder / "a.ply")
    assert np.array_equal(back.vertices, vertices) and back.comments == ("metres", "robot 0 r1")


@pytest.mark.parametrize(
    ("name", "text", "read", "said"),
    [
        ("a.tum", "1.0 2 3", read_tum, "line 1: no pose"),
        ("a.tum", "now 0 0 0 0 0 0 1", read_tum, "no time"),
        ("a.tum", "1 0 0 0 0 0 0 0", read_tum, "line 1: no pose"),
        ("a.txt", "1 2 3", read_kitti, "line 1: no pose"),
        ("a.txt", " ".join("1" * 12), read_kitti, "line 1: no pose"),
        ("a.g2o", "VERTEX_SE3:QUAT 1 0 0 0", read_g2o, "line 1 has 4 numbers, need 8"),
        ("a.g2o", "VERTEX_SE3:QUAT x 0 0 0 0 0 0 1", read_g2o, "no number"),
        ("a.g2o", "VERTEX_SE3:QUAT 1 0 0 0 0 0 0 0", read_g2o, "no rotation"),
    ],
)
def test_what_is_wrong_with_a_file_is_a_sentence(tmp_path, name, text, read, said):
    (tmp_path / name).write_text(text)
    with pytest.raises(FormatError, match=said):
        read(tmp_path / name)
    with pytest.raises(FormatError, match="cannot be read"):
        read(tmp_path / "none")
