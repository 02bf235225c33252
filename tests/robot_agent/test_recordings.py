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
from fleetpose.robot_agent.cameras.replay import replay_order
from fleetpose.robot_agent.cameras.rgbd.recording import KINECT_NOISE

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
    own = np.array([[530.0, 0, 320], [0, 531, 241], [0, 0, 1]])
    np.savetxt(tum / "camera-intrinsics.txt", own)
    assert np.array_equal(frames_of("rgbd", tum)[0].model.K, own)
    np.savetxt(tum / "camera-intrinsics.txt", own * ((0.5,), (0.5,), (1,)))
    with pytest.raises(CalibrationError, match=r"641x483.*640x480|321x242.*640x480"):
        frames_of("rgbd", tum)


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


def shots_of(folder, colour, depth, count=3, size=(640, 480), steps=2000):
    """Images under names with a place for their number; depth grows by 1 m at so many steps."""
    for n in range(count):
        for name, image in (
            (colour, cv2.resize(picture(20 * n + 20), size)),
            (depth, np.full((480, 640), steps * (n + 1), np.uint16)),
        ):
            path = folder / name.format(n)
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)


def icl_nuim(folder):
    shots_of(folder, "rgb/{}.png", "depth/{}.png", steps=5000)
    lines = [f"{n} depth/{n}.png {n} rgb/{n}.png" for n in range(3)]
    (folder / "associations.txt").write_text("\n".join(lines))
    (folder / "camera-intrinsics.txt").write_text("481.2 0 319.5\n0 480 239.5\n0 0 1")
    return 481.2


def eth3d(folder):
    shots_of(folder, "rgb/{}.png", "depth/{}.png", steps=5000)
    for kind in ("rgb", "depth"):
        lines = [f"{100 + n}.25 {kind}/{n}.png" for n in range(3)]
        (folder / f"{kind}.txt").write_text("\n".join(lines))
    (folder / "calibration.txt").write_text("726.28 726.28 354.6 186.4")
    return 726.28


def scannet(folder):
    shots_of(folder, "color/{}.jpg", "depth/{}.png", count=12, size=(1296, 968), steps=400)
    (folder / "intrinsic").mkdir()
    rows = ("577.9 0 319.5 0", "0 578.7 239.5 0", "0 0 1 0", "0 0 0 1")
    (folder / "intrinsic/intrinsic_depth.txt").write_text("\n".join(rows))
    return 577.9


def replica(folder):
    shots_of(folder, "room/results/frame{:06d}.jpg", "room/results/depth{:06d}.png", steps=6553)
    camera = {"w": 640, "h": 480, "fx": 600.0, "fy": 600.0, "cx": 319.5, "cy": 239.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera | {"scale": 6553.5}}))
    return 600.0


def two_folders_of_open3d(folder):
    shots_of(folder, "color/color_{:05d}.jpg", "depth/depth_{:05d}.png", steps=1000)
    matrix = {"width": 640, "height": 480}
    matrix["intrinsic_matrix"] = [610.0, 0, 0, 0, 611.0, 0, 319.0, 241.0, 1]
    (folder / "camera_intrinsic.json").write_text(json.dumps(matrix))
    return 610.0


@pytest.mark.parametrize("write", [icl_nuim, eth3d, scannet, replica, two_folders_of_open3d])
def test_folders_as_they_are_downloaded(write, tmp_path):
    f = write(tmp_path)
    folder = tmp_path / "room" if write is replica else tmp_path
    frames = frames_of("rgbd", folder)
    assert len(frames) == (12 if write is scannet else 3)
    assert frames[0].model.K[0, 0] == f and frames[0].image.shape == (480, 640, 3)
    depths = [float(frame.ranges.depth_m[5, 5]) for frame in frames[:3]]
    step = 0.4 if write is scannet else 1.0
    np.testing.assert_allclose(depths, [step, 2 * step, 3 * step], rtol=1e-3)
    assert [int(frame.image.mean()) for frame in frames[:3]] == pytest.approx([20, 40, 60], abs=1)


def test_millimetres_in_a_layout_of_fifths_are_asked_for(tum):
    for n in range(4):
        cv2.imwrite(str(tum / f"depth/{n}.png"), np.full((480, 640), 1000 * (n + 1), np.uint16))
    with pytest.raises(DataFolderError, match=r"0\.2 to 0\.8 m at 5000 .*--depth-scale"):
        frames_of("rgbd", tum)
    camera = open_camera("rgbd", str(tum), "once", depth_scale=1000.0)
    assert float(next(camera.frames()).ranges.depth_m[0, 0]) == 1.0
    camera.close()


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_colour_of_any_depth_of_bits_is_as_bright(seven_scenes, bits):
    (seven_scenes / "frame-000000.color_registered.jpg").unlink(missing_ok=True)
    bright = np.full((48, 64, 3), (1 << bits) - 1, np.uint16)
    bright[:24] = 100 << (bits - 8)
    cv2.imwrite(str(seven_scenes / "frame-000000.color_registered.png"), bright)
    image = frames_of("rgbd", seven_scenes)[0].image
    assert image[0, 0, 0] == 100 and image[40, 0, 0] == 255


def test_lists_with_a_byte_order_mark_commas_and_nanoseconds(tum):
    for kind in ("rgb", "depth"):
        lines = [f"{(1_400_000_000 + n) * 10**9},{kind}/{n}.png" for n in range(4)]
        (tum / f"{kind}.txt").write_text("\ufeff# time, file\r\n" + "\r\n".join(lines))
    assert len(frames_of("rgbd", tum)) == 4
    (tum / "rgb.txt").write_text("100.0 rgb/0.png\nnothing")
    with pytest.raises(DataFolderError, match=r"rgb\.txt, line 2"):
        frames_of("rgbd", tum)


def test_images_of_two_eyes_belong_together_by_their_names(tmp_path):
    from fleetpose.robot_agent.cameras.folders.pairing import list_images, paired

    for side, numbers in (("left", (1, 2, 10, 11)), ("right", (1, 3, 10, 11))):
        (tmp_path / side).mkdir()
        for n in numbers:
            (tmp_path / side / f"{side}{n}.png").write_bytes(b"")
    left, right = list_images(tmp_path / "left"), list_images(tmp_path / "right")
    assert [path.stem for path in left] == ["left1", "left2", "left10", "left11"]
    pairs = [(one.stem, other.stem) for one, other in paired(left, right)]
    assert pairs == [("left1", "right1"), ("left10", "right10"), ("left11", "right11")]
    stamps = [1_403_636_579_763_555_584 + k * 50_000_000 for k in range(4)]
    one = [tmp_path / f"{stamp}.png" for stamp in stamps]
    other = [tmp_path / f"{stamp + 2_000_000}.png" for stamp in stamps[1:]]
    assert paired(one, other) == list(zip(one[1:], other, strict=True))
    with pytest.raises(DataFolderError, match="has no partner"):
        paired(one, [tmp_path / "a.png"])
