"""Clouds without images: what files hold, what a camera makes of it, and what it refuses."""

import struct

import numpy as np
import pytest

from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.errors import DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel, ViewName
from fleetpose.robot_agent.cameras.base import DepthImage, ScatteredPoints
from fleetpose.robot_agent.cameras.folders.cloud import FIELD_DEG, frame_of, open_camera
from fleetpose.robot_agent.cameras.folders.cloud_files import read_points
from fleetpose.robot_agent.features.depth_picture import picture_of
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of

EPOCH = "0" * 12


def room(count=2000, seed=0):
    """Points (N, 3) around a robot that stands in a room, in its axes."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    return points / np.abs(points).max(axis=1, keepdims=True) * (5.0, 4.0, 2.0)


def header(count, form="ascii", kind="float"):
    axes = "".join(f"property {kind} {axis}\n" for axis in "xyz")
    return f"ply\nformat {form} 1.0\nelement vertex {count}\n{axes}end_header\n".encode()


def pcd(points, form, height=1):
    width = len(points.reshape(-1, 3)) // height
    head = (
        f"# .PCD v.7\nVERSION .7\nFIELDS x y z intensity _\nSIZE 4 4 4 4 1\nTYPE F F F F U\n"
        f"COUNT 1 1 1 1 4\nWIDTH {width}\nHEIGHT {height}\nPOINTS {width * height}\nDATA {form}\n"
    )
    flat = points.reshape(-1, 3)
    if form == "ascii":
        body = "\n".join(" ".join(map(str, (*p, 1.0, 0, 0, 0, 0))) for p in flat).encode()
    else:
        body = b"".join(struct.pack("<ffff4x", *p, 1.0) for p in flat)
    return head.encode() + body


def files(points):
    """The same cloud in every format, as (name, bytes)."""
    flat = points.reshape(-1, 3)
    ascii_body = "\n".join(" ".join(map(str, p)) for p in flat).encode()
    yield "a.ply", header(len(flat)) + ascii_body
    yield "l.ply", header(len(flat), "binary_little_endian") + flat.astype("<f4").tobytes()
    big = header(len(flat), "binary_big_endian", "double")
    yield "b.ply", big + flat.astype(">f8").tobytes()
    yield "a.pcd", pcd(points, "ascii")
    yield "b.pcd", pcd(points, "binary")


def test_all_formats_hold_the_same_points(tmp_path):
    points = np.round(room(50), 3)
    for name, content in files(points):
        (tmp_path / name).write_bytes(content)
    np.savez(tmp_path / "c.npz", points=points)
    np.save(tmp_path / "c.npy", points)
    for path in tmp_path.iterdir():
        np.testing.assert_allclose(read_points(path), points, atol=1e-6, err_msg=path.name)


def test_an_organised_file_keeps_its_rows(tmp_path):
    points = room(12).reshape(3, 4, 3)
    (tmp_path / "o.pcd").write_bytes(pcd(points, "binary", height=3))
    np.testing.assert_allclose(read_points(tmp_path / "o.pcd"), points, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("cut.ply", header(100, "binary_little_endian") + bytes(30)),
        ("short.ply", header(100) + b"1 2 3\n"),
        ("huge.ply", header(10**12) + b"1 2 3\n"),
        ("negative.ply", header(-1) + b"1 2 3\n"),
        ("words.ply", header(1) + b"a b c\n"),
        ("flat.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"),
        ("faces.ply", b"ply\nformat ascii 1.0\nelement face 1\nend_header\n"),
        ("none.ply", b""),
        ("none.pcd", b""),
        ("cut.pcd", pcd(room(10), "binary")[:-20]),
        ("packed.pcd", pcd(room(10), "binary_compressed")),
        ("none.npz", b"PK"),
        ("none.npy", b"no array"),
        ("cloud.las", b"LASF"),
    ],
)
def test_a_file_that_holds_no_cloud_is_a_sentence(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataFolderError, match=name):
        read_points(tmp_path / name)


@pytest.mark.parametrize("shape", [(5,), (4, 2), (2, 2, 2, 3)])
def test_an_array_that_is_no_cloud_is_a_sentence(tmp_path, shape):
    np.save(tmp_path / "c.npy", np.ones(shape))
    with pytest.raises(DataFolderError, match="need"):
        read_points(tmp_path / "c.npy")


def test_an_empty_folder_is_a_sentence(tmp_path):
    with pytest.raises(DataFolderError, match=r"\.ply"):
        open_camera(str(tmp_path), "once")


def test_what_lies_ahead_is_sent_where_it_is(tmp_path):
    points = room()
    np.save(tmp_path / "c.npy", points)
    frame = next(open_camera(str(tmp_path), "once").frames())
    sent = points_of(view_of(ViewName(robot="r1", epoch=EPOCH, seq=0), frame, salient_of(frame)))
    in_robot = sent.xyz @ ROBOT_FROM_CAMERA[:3, :3].T
    ahead = points[points[:, 0] > 0]
    half = np.radians(np.array(FIELD_DEG)) / 2
    inside = (np.abs(ahead[:, 1:] / ahead[:, :1]) < np.tan(half) - 0.01).all(axis=1)
    off = np.linalg.norm(ahead[inside][:, None] - in_robot[None], axis=2).min(axis=1)
    assert inside.sum() > 200
    assert off.max() < 0.01
    assert not frame.has_image
    assert len(salient_of(frame).uv) == 0


def test_an_organised_cloud_of_a_pinhole_camera_is_its_depth_image():
    K = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
    v, u = np.mgrid[:240, :320]
    depth = 2.0 + 0.002 * u
    points = np.stack(((u - 159.5) / 300 * depth, (v - 119.5) / 300 * depth, depth), axis=2)
    points[10, 20] = np.nan
    frame = frame_of(points)
    assert frame is not None
    assert isinstance(frame.ranges, DepthImage)
    np.testing.assert_allclose(frame.model.K, K, atol=1e-6)
    assert np.isnan(frame.ranges.depth_m[10, 20])
    np.testing.assert_allclose(frame.ranges.depth_m[0, 0], 2.0, atol=1e-6)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((40, 3)),
        np.full((40, 3), np.nan),
        np.tile((0.0, 0.0, -1.0), (40, 1)),
        np.tile((0.0, 0.0, np.inf), (40, 1)),
        np.array([[0.0, 0, 1], [0, 1, 1], [1, 0, 1]]),
    ],
    ids=["none", "at the sensor", "nan", "behind", "infinite", "three"],
)
def test_a_scan_of_nothing_ahead_is_left_out(points):
    assert frame_of(points) is None


def test_a_scan_of_nothing_does_not_end_the_robot(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((0, 3)))
    np.save(tmp_path / "b.npy", room())
    assert len(list(open_camera(str(tmp_path), "once").frames())) == 1


def test_a_million_points_are_thinned():
    points = np.random.default_rng(0).normal((0, 0, 5), 0.3, (1_000_000, 3))
    frame = frame_of(points)
    assert frame is not None
    assert isinstance(frame.ranges, ScatteredPoints)
    assert len(frame.ranges.z) <= 200_000


def test_the_picture_shows_where_there_is_something():
    model = Camera(
        width=64, height=48, K=np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]]),
        T_robot_camera=ROBOT_FROM_CAMERA, kind="cloud",
        noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.01, 0, 0)),
    )  # fmt: skip
    depth = np.full((48, 64), np.nan, np.float32)
    depth[:, 32:] = np.linspace(1.0, 3.0, 32)
    picture = picture_of(DepthImage(depth), model)
    assert not picture[:, :30].any()
    assert (picture[:, 34:].max(axis=2) > 0).all()
    near, far = picture[24, 34].astype(int), picture[24, 60].astype(int)
    assert near[2] > near[0]  # red
    assert far[0] > far[2]  # blue
    nothing = picture_of(ScatteredPoints(np.zeros((0, 2)), np.zeros(0)), model)
    assert not nothing.any()


@pytest.mark.parametrize("replay", ["once", "loop", "hold"])
def test_a_folder_of_nothing_but_empty_scans_ends_with_a_sentence(tmp_path, replay):
    for name in ("a", "b"):
        np.save(tmp_path / f"{name}.npy", np.zeros((0, 3)))
    with pytest.raises(DataFolderError, match="axes"):
        list(open_camera(str(tmp_path), replay).frames())


def test_the_picture_of_a_coarse_depth_image_without_depth_has_the_cameras_size():
    frame = frame_of(np.random.default_rng(0).normal((0, 0, 5), 0.3, (100, 3)))
    assert frame is not None
    model = frame.model.model_copy(update={"width": 64, "height": 48})
    assert picture_of(DepthImage(np.full((24, 32), np.nan, np.float32)), model).shape == (48, 64, 3)
