"""Recorded cameras: what is on disk comes out as frames, and what is missing is said."""

import itertools
import json
import logging
import time

import cv2
import numpy as np
import pytest

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.cameras.base import DepthImage, ScatteredPoints
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.cameras.folders.rgbd import KINECT_NOISE
from fleetpose.robot_agent.cameras.replay import replay_order

K = np.array([[60.0, 0.0, 31.5], [0.0, 61.0, 23.5], [0.0, 0.0, 1.0]])


def picture(shade):
    return np.full((48, 64, 3), shade, np.uint8)


def depth_mm():
    depth = np.full((48, 64), 1500, np.uint16)
    depth[0, :4] = (0, 65535, 6001, 5999)
    return depth


@pytest.fixture
def seven_scenes(tmp_path):
    for n in range(3):
        cv2.imwrite(str(tmp_path / f"frame-{n:06d}.color_registered.jpg"), picture(50 * n + 50))
        cv2.imwrite(str(tmp_path / f"frame-{n:06d}.color.jpg"), picture(250))
        cv2.imwrite(str(tmp_path / f"frame-{n:06d}.depth.png"), depth_mm() + n)
    np.savetxt(tmp_path / "camera-intrinsics.txt", K)
    return tmp_path


@pytest.fixture
def tum(tmp_path):
    for folder in ("rgb", "depth"):
        (tmp_path / folder).mkdir()
    colours, depths = ["# time file"], ["# time file"]  # images as large as the default matrix asks
    for n in range(4):
        depth = np.full((480, 640), 5000 * (n + 1), np.uint16)
        cv2.imwrite(str(tmp_path / f"rgb/{n}.png"), cv2.resize(picture(20 * n + 20), (640, 480)))
        cv2.imwrite(str(tmp_path / f"depth/{n}.png"), depth)
        colours.append(f"{100 + n}.000 rgb/{n}.png")
        depths.append(f"{100 + n + (0.5 if n == 1 else 0.008)} depth/{n}.png")
    (tmp_path / "rgb.txt").write_text("\n".join(colours))
    (tmp_path / "depth.txt").write_text("\n".join(depths))
    return tmp_path


@pytest.fixture
def views(tmp_path):
    rng = np.random.default_rng(0)
    (tmp_path / "images").mkdir()
    entries = []
    for n, name in enumerate(("b.png", "a.png", "without_cloud.png")):
        cv2.imwrite(str(tmp_path / "images" / name), picture(60 * n + 60))
        entries.append({"name": name, "width": 64, "height": 48, "K": (K + n).tolist()})
        entries[-1]["K"][1][0] = entries[-1]["K"][2][0] = entries[-1]["K"][2][1] = 0
        entries[-1]["K"][2][2] = 1
    z = rng.uniform(2, 4, 30)
    xyz = np.column_stack((rng.uniform(-0.4, 0.4, 30) * z, rng.uniform(-0.3, 0.3, 30) * z, z))
    for kind, more in (
        ("clouds", {}),
        ("sparse_noisy", {"sigma_z": 0.004 * z**2, "track_id": np.arange(30)}),
        ("stereo", {}),
    ):
        (tmp_path / kind).mkdir()
        for name in ("a", "b"):
            uv = np.zeros((30, 2), np.float32)
            np.savez(tmp_path / kind / f"{name}.npz", uv=uv, xyz_cam=xyz.astype(np.float32), **more)
    index = {name: {"baseline_m": 0.2} for name in ("a.png", "b.png")}
    (tmp_path / "stereo" / "index.json").write_text(json.dumps(index))
    write_cameras(tmp_path, entries)
    return tmp_path


def write_cameras(folder, entries, **more):
    (folder / "cameras.json").write_text(json.dumps({"cameras": entries, **more}))


def cameras_of(folder):
    return json.loads((folder / "cameras.json").read_text())["cameras"]


def frames_of(kind, folder, replay="once", **options):
    camera = open_camera(kind, str(folder), replay, **options)
    try:
        return list(itertools.islice(camera.frames(), 12))
    finally:
        camera.close()


@pytest.mark.parametrize(
    ("replay", "expected"),
    [
        ("once", [0, 1, 2, 3]),
        ("loop", [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]),
        ("pingpong", [0, 1, 2, 3, 2, 1, 0, 1, 2, 3]),
        ("hold", [0] * 10),
    ],
)
def test_replay_orders(replay, expected):
    assert list(itertools.islice(replay_order(4, replay), 10)) == expected


@pytest.mark.parametrize("replay", ["loop", "pingpong", "hold"])
@pytest.mark.parametrize("count", [1, 2])
def test_short_recordings_replay_without_end(replay, count):
    indices = list(itertools.islice(replay_order(count, replay), 9))
    assert len(indices) == 9
    assert set(indices) <= set(range(count))


def test_a_replay_that_does_not_exist_is_refused():
    with pytest.raises(DataFolderError, match="pingpong"):
        replay_order(3, "backwards")


def test_seven_scenes_frames_have_registered_colour_depth_and_calibration(seven_scenes):
    before = time.time_ns()
    frames = frames_of("rgbd", seven_scenes)
    assert [int(frame.image.mean()) for frame in frames] == [50, 100, 150]
    first = frames[0]
    assert isinstance(first.ranges, DepthImage)
    assert np.isnan(first.ranges.depth_m[0, :3]).all()
    assert np.allclose(first.ranges.depth_m[0, 3:6], (5.999, 1.5, 1.5))
    assert np.array_equal(first.model.K, K)
    assert (first.model.width, first.model.height) == (64, 48)
    assert first.model.noise == KINECT_NOISE
    assert before <= first.stamp_ns <= frames[1].stamp_ns <= time.time_ns()


def test_colour_that_is_not_registered_is_taken_with_a_warning(seven_scenes, caplog):
    for path in seven_scenes.glob("*.color_registered.jpg"):
        path.unlink()
    with caplog.at_level(logging.WARNING):
        assert [int(frame.image.mean()) for frame in frames_of("rgbd", seven_scenes)] == [250] * 3
    assert "registered" in caplog.text


def test_calib_json_serves_where_there_is_no_matrix(seven_scenes):
    (seven_scenes / "camera-intrinsics.txt").unlink()
    noise = {"pixel_sigma_px": 0.4, "depth_sigma_m": [0.01, 0.0, 0.0]}
    calib = {"depth_intrinsics": {"fx": 60, "fy": 61, "cx": 31.5, "cy": 23.5}, "noise": noise}
    (seven_scenes / "calib.json").write_text(json.dumps(calib))
    model = frames_of("rgbd", seven_scenes)[0].model
    assert np.array_equal(model.K, K)
    assert model.noise.depth_sigma_m == (0.01, 0.0, 0.0)


def test_missing_calibration_says_what_to_put_where(seven_scenes):
    (seven_scenes / "camera-intrinsics.txt").unlink()
    with pytest.raises(CalibrationError, match=r"put the 3x3 matrix .* camera-intrinsics\.txt"):
        frames_of("rgbd", seven_scenes)


@pytest.mark.parametrize("content", ["1 2 3", "a b c\n" * 3, "1 0 0\n5 1 0\n0 0 1", "0 0 0\n" * 3])
def test_a_matrix_that_is_no_calibration_is_refused(seven_scenes, content):
    (seven_scenes / "camera-intrinsics.txt").write_text(content)
    with pytest.raises(CalibrationError):
        frames_of("rgbd", seven_scenes)


def test_colour_of_another_size_than_depth_is_refused(seven_scenes):
    path = seven_scenes / "frame-000000.color_registered.jpg"
    cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(CalibrationError, match="32x24"):
        frames_of("rgbd", seven_scenes)


def test_depth_without_colour_names_the_missing_file(seven_scenes):
    for path in seven_scenes.glob("frame-000001.color*"):
        path.unlink()
    with pytest.raises(DataFolderError, match=r"frame-000001\.color_registered\.jpg"):
        frames_of("rgbd", seven_scenes)


def test_tum_frames_are_associated_by_time(tum, caplog):
    with caplog.at_level(logging.WARNING):
        frames = frames_of("rgbd", tum)
    assert "default" in caplog.text
    assert [int(frame.image.mean()) for frame in frames] == [20, 60, 80]
    assert [float(frame.ranges.depth_m[5, 5]) for frame in frames] == [1.0, 3.0, 4.0]
    assert frames[0].model.K[0, 0] == 525.0


def test_tum_folders_may_bring_their_own_matrix(tum):
    np.savetxt(tum / "camera-intrinsics.txt", K)
    assert np.array_equal(frames_of("rgbd", tum)[0].model.K, K)


@pytest.mark.parametrize("kind", ["rgbd", "views"])
def test_an_empty_folder_is_refused(tmp_path, kind):
    with pytest.raises((DataFolderError, CalibrationError)):
        frames_of(kind, tmp_path)


def test_views_come_by_name_with_their_own_matrix_and_exact_points(views):
    frames = frames_of("views", views)
    assert [int(frame.image.mean()) for frame in frames] == [120, 60]  # a before b
    assert frames[0].model.K[0, 0] != frames[1].model.K[0, 0]
    for frame in frames:
        assert isinstance(frame.ranges, ScatteredPoints)
        rays = np.column_stack((frame.ranges.uv, np.ones(len(frame.ranges.z))))
        xyz = (rays @ np.linalg.inv(frame.model.K).T) * frame.ranges.z[:, None]
        stored = np.load(views / "clouds" / "a.npz")["xyz_cam"]
        nearest = np.abs(xyz[:, None] - stored[None]).max(axis=2).min(axis=1)
        assert len(xyz) > 10
        assert nearest.max() < 1e-6


def test_one_view_can_be_chosen_by_name(views):
    assert [int(frame.image.mean()) for frame in frames_of("views", views, view="b")] == [60]
    assert [int(frame.image.mean()) for frame in frames_of("views", views, view="b.png")] == [60]
    with pytest.raises(DataFolderError, match="'c'"):
        frames_of("views", views, view="c")


def test_noise_is_read_from_where_it_is_stated(views):
    def depth_sigma(**options):
        return frames_of("views", views, **options)[0].model.noise.depth_sigma_m

    assert depth_sigma() == pytest.approx((0, 0.003, 0))
    assert depth_sigma(clouds="sparse_noisy") == pytest.approx((0, 0, 0.004))
    focal = frames_of("views", views)[0].model.K[0, 0]
    assert depth_sigma(clouds="stereo") == pytest.approx((0, 0, 0.5 * np.sqrt(2) / (focal * 0.2)))
    stated = {"pixel_sigma_px": 0.3, "depth_sigma_m": [0.0, 0.0, 0.05], "focal_baseline_px_m": 9.0}
    write_cameras(views, cameras_of(views), noise=stated)
    assert depth_sigma(clouds="sparse_noisy") == pytest.approx((0, 0, 0.05))
    entries = [{**entry, "noise": {**stated, "pixel_sigma_px": 0.2}} for entry in cameras_of(views)]
    write_cameras(views, entries)
    assert frames_of("views", views)[0].model.noise.pixel_sigma_px == 0.2


def test_a_kind_of_clouds_that_is_not_there_is_refused_with_those_that_are(views):
    with pytest.raises(DataFolderError, match="clouds, sparse_noisy, stereo"):
        frames_of("views", views, clouds="dense")


@pytest.mark.parametrize(
    "noise", [{"pixel_sigma_px": -1.0, "depth_sigma_m": [0, 0, 0]}, {"depth_sigma_m": 3}, "good"]
)
def test_impossible_noise_is_refused(views, noise):
    write_cameras(views, cameras_of(views), noise=noise)
    with pytest.raises(CalibrationError, match="noise"):
        frames_of("views", views)


def test_an_image_of_another_size_than_stated_is_refused(views):
    write_cameras(views, [{**entry, "width": 65} for entry in cameras_of(views)])
    with pytest.raises(CalibrationError, match="65x48"):
        frames_of("views", views)


def test_a_damaged_cloud_is_refused_by_name(views):
    (views / "clouds" / "a.npz").write_bytes(b"no archive")
    with pytest.raises(DataFolderError, match=r"a\.npz"):
        frames_of("views", views)


def test_poses_are_not_needed_and_not_read(views):
    entries = [{**entry, "R_world_to_cam": "nonsense"} for entry in cameras_of(views)]
    write_cameras(views, entries)
    assert len(frames_of("views", views)) == 2
