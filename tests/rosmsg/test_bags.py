"""Bags of every kind against what was written into them: nothing is lost, nothing is bent."""

import shutil
from itertools import pairwise

import cv2
import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.__main__ import app
from fleetpose.robot_agent.cameras.bag.camera import open_camera
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from fleetpose.robot_agent.cameras.base import DepthImage, DisparityImage, ScatteredPoints
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.topics.lenses import rig_of
from fleetpose.rosmsg.bag import Bag
from fleetpose.rosmsg.camera_infos import camera_info
from tests.data import shared_data
from tests.rosmsg import bag_makers as makers

SQLITE = {"plugin": StoragePlugin.SQLITE3}
VARIANTS = {
    "mcap": {},
    "sqlite3": {"colour": "bgr8", **SQLITE},
    "ros1.bag": {"colour": "bgr8", "ros": 1},
    "packed_ros1.bag": {"depth": "compressed png", "ros": 1},
    "packed": {"colour": "jpeg", "depth": "compressed png"},
    "rvl": {"depth": "compressed rvl"},
    "metres": {"depth": "32FC1"},
    "inverse": {"depth": "compressed inverse"},
    "zstd_messages": {**SQLITE, "compression": makers.ZSTD_MESSAGES},
    "zstd_storage": {"compression": makers.ZSTD_STORAGE},
}


def frames_of(path, replay="once", **options):
    camera = open_camera(str(path), replay, bag=BagOptions(**{"speed": None, **options}))
    try:
        return list(camera.frames())
    finally:
        camera.close()


def true_depth(mm, furthest_m=6.0):
    depth = np.where((mm == 0) | (mm == 65535), np.nan, mm / 1000)
    depth[depth > furthest_m] = np.nan
    return depth


@pytest.mark.parametrize("name", VARIANTS)
def test_every_frame_comes_back_as_it_was_written(name, tmp_path):
    made, options = makers.source(), VARIANTS[name]
    frames = frames_of(makers.write_rgbd(tmp_path / name, made, **options))
    assert len(frames) == len(made.colours)
    for k, frame in enumerate(frames):
        assert frame.stamp_ns == makers.BEGIN_NS + k * makers.PERIOD_NS
        assert isinstance(frame.ranges, DepthImage)
        true, found = true_depth(made.depths[k]), frame.ranges.depth_m
        quantum = 1.01 / makers.QUANT_A if options.get("depth") == "compressed inverse" else 1e-7
        assert np.array_equal(np.isnan(found), np.isnan(true))
        assert np.nanmax(np.abs(found - true) / true**2) <= quantum
        if options.get("colour") == "jpeg":
            smooth, true = (cv2.blur(i, (9, 9)).astype(int) for i in (frame.image, made.colours[k]))
            assert np.abs(smooth - true).mean() < 3
        else:
            assert np.array_equal(frame.image, made.colours[k])
        assert np.array_equal(frame.model.K, makers.K)
        T_base_camera = makers.T_BASE_LINK @ makers.T_LINK_OPTICAL
        assert np.allclose(frame.model.T_robot_camera, T_base_camera, atol=1e-9)
        assert frame.odometry is not None and frame.odometry.covariance is not None
        assert np.allclose(frame.odometry.T_odom_robot, makers.T_odom_base(k), atol=1e-9)


def test_a_robots_own_topics_and_the_recorders_clock_can_be_asked_for(tmp_path):
    path = makers.write_rgbd(tmp_path / "bag", makers.source(3))
    stamps = [f.stamp_ns for f in frames_of(path, namespace="/r1", stamps="receive")]
    assert stamps == [makers.BEGIN_NS + k * makers.PERIOD_NS + 20_000_000 for k in range(3)]
    with pytest.raises(DataFolderError, match="no camera among the topics below '/r2'"):
        frames_of(path, namespace="/r2")
    with pytest.raises(DataFolderError, match="no messages of '/nowhere'"):
        frames_of(path, depth="/nowhere")


def test_a_loop_goes_on_in_time(tmp_path):
    camera = open_camera(
        str(makers.write_rgbd(tmp_path / "bag", makers.source(3))),
        "loop",
        bag=BagOptions(speed=None),
    )
    stamps = [frame.stamp_ns for _, frame in zip(range(7), camera.frames(), strict=False)]
    camera.close()
    assert {b - a for a, b in pairwise(stamps)} == {makers.PERIOD_NS}
    with pytest.raises(DataFolderError, match="once, loop, hold"):
        frames_of(tmp_path / "bag", "pingpong")


def test_of_a_bag_that_plays_too_fast_the_newest_frames_are_shown(tmp_path):
    path = makers.write_rgbd(tmp_path / "bag", makers.source(30))
    frames = frames_of(path, speed=1e6)
    assert frames[-1].stamp_ns == makers.BEGIN_NS + 29 * makers.PERIOD_NS and len(frames) < 30


def test_split_files_are_one_recording_with_and_without_their_metadata(tmp_path):
    made, folder = makers.source(6), tmp_path / "split"
    folder.mkdir()
    for part in (0, 1):
        half = makers.Source(made.colours[3 * part :][:3], made.depths[3 * part :][:3])
        one = tmp_path / f"part{part}"
        makers.write_rgbd(one, half)
        shutil.move(next(one.glob("*.mcap")), folder / f"bag_{part}.mcap")
    both = f"{folder}/bag_0.mcap,{folder}/bag_1.mcap"
    for source in (folder, both):
        bag = Bag(str(source))
        assert {topic.name: topic.count for topic in bag.topics}["/r1/odom"] == 6
        received = [message.received_ns for message in bag.messages()]
        assert received == sorted(received)
        bag.close()


def test_of_a_file_that_was_cut_off_what_is_left_is_given_with_a_warning(tmp_path, caplog):
    made = makers.source(90)  # three chunks
    whole = next(makers.write_rgbd(tmp_path / "bag", made).glob("*.mcap"))
    data = whole.read_bytes()
    whole.write_bytes(data[: len(data) * 2 // 3])
    frames = frames_of(tmp_path / "bag")
    assert 10 < len(frames) < 80
    assert np.array_equal(frames[-1].image, made.colours[len(frames) - 1])
    assert "was the recorder killed?" in caplog.text
    whole.write_bytes(data[:100])
    with pytest.raises(DataFolderError, match="nothing is left of it"):
        Bag(str(whole))


def test_types_that_nobody_knows_stop_nothing(tmp_path, caplog):
    with makers.Maker(tmp_path / "bag") as bag:
        message = bag.image(makers.source(1).colours[0], "bgr8", 0, "camera")
        bag.put("/good", message, 1)
        odd = {"msgdef": "strange_msgs/Other a\n", "rihs01": "RIHS01_" + 64 * "0"}
        kind = bag.writer.add_connection("/odd", "strange_msgs/msg/Odd", **odd)
        bag.writer.write(kind, 2, b"\x00\x01")
        bag.put("/good", message, 3)
    bag = Bag(str(tmp_path / "bag"))
    read = [bag.read(message) for message in bag.messages()]
    bag.close()
    assert [one is None for one in read] == [False, True, False]
    assert bag.unreadable == {"strange_msgs/msg/Odd": 1} and "/odd" in caplog.text


def test_an_organised_cloud_is_the_depth_image_and_others_are_scattered(tmp_path):
    made, frame = makers.source(2), "optical"
    v, u = np.mgrid[: makers.HEIGHT, : makers.WIDTH]
    f, (cx, cy) = makers.K[0, 0], makers.K[:2, 2]
    with makers.Maker(tmp_path / "bag") as bag:
        for k, (bgr, mm) in enumerate(zip(made.colours, made.depths, strict=True)):
            z = true_depth(mm)
            xyz = np.stack(((u - cx) / f * z, (v - cy) / f * z, z), axis=-1)
            at_ns = makers.BEGIN_NS + k * makers.PERIOD_NS
            bag.put("/color/image_raw", bag.image(bgr, "bgr8", at_ns, frame), at_ns)
            bag.put("/color/camera_info", bag.info(at_ns, frame), at_ns)
            bag.put("/points", bag.cloud(xyz, at_ns, frame), at_ns)
            flat = xyz[np.isfinite(z)][None, ::7]
            bag.put("/lidar", bag.cloud(flat, at_ns, "lidar"), at_ns)
        bag.put("/tf_static", bag.transforms(0, (frame, "lidar", np.eye(4))), at_ns)
    for k, one in enumerate(frames_of(tmp_path / "bag", cloud="/points")):
        assert isinstance(one.ranges, DepthImage)
        assert np.allclose(
            one.ranges.depth_m, true_depth(made.depths[k]), atol=1e-6, equal_nan=True
        )
    for k, one in enumerate(frames_of(tmp_path / "bag", cloud="/lidar")):
        assert isinstance(one.ranges, ScatteredPoints)
        columns, rows = np.rint(one.ranges.uv).astype(int).T
        assert len(rows) > 500
        assert np.allclose(true_depth(made.depths[k])[rows, columns], one.ranges.z, atol=1e-5)


def test_depth_of_another_camera_is_projected_into_the_image(tmp_path):
    """A wall 2 m away, seen by a depth camera of twice the focal length, 0.1 m to the left."""
    K_depth = makers.K * [[2], [2], [1]]
    K_depth[:2, 2] = makers.K[:2, 2]
    T = np.eye(4)
    T[0, 3] = -0.1
    wall = np.full((makers.HEIGHT, makers.WIDTH), 2000, np.uint16)
    with makers.Maker(tmp_path / "bag") as bag:
        bag.put("/color/image_raw", bag.image(makers.source(1).colours[0], "bgr8", 0, "c"), 0)
        bag.put("/color/camera_info", bag.info(0, "c"), 0)
        bag.put("/depth/image_rect_raw", bag.image(wall, "16UC1", 0, "d"), 0)
        bag.put("/depth/camera_info", bag.info(0, "d", K=K_depth), 0)
        bag.put("/tf_static", bag.transforms(0, ("c", "d", T)), 0)
    [frame] = frames_of(tmp_path / "bag")
    depth = frame.ranges.depth_m
    rows, columns = np.nonzero(np.isfinite(depth))
    assert np.allclose(depth[rows, columns], 2.0)
    middle = makers.K[0, 2] - 0.1 / 2.0 * makers.K[0, 0]  # its axis, in the image
    assert columns.min() == pytest.approx(middle - makers.WIDTH / 4, abs=1)
    assert columns.max() == pytest.approx(middle + makers.WIDTH / 4, abs=1)
    assert np.ptp(rows) == pytest.approx(makers.HEIGHT / 2, abs=2)


K_LEFT = np.array([[150.0, 0, 81.0], [0, 151.0, 58.0], [0, 0, 1]])
K_RIGHT = np.array([[152.0, 0, 79.0], [0, 149.0, 61.0], [0, 0, 1]])
D_LEFT, D_RIGHT = np.array((-0.1, 0.02, 1e-3, -1e-3, 0.0)), np.array((-0.12, 0.03, 0, 1e-3, 0.0))
STEREO_SIZE = (160, 120)


@pytest.fixture
def rig():
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array((0.01, -0.02, 0.015)))[0]
    T[:3, 3] = (-0.12, 0.002, -0.001)
    T_robot_left = makers.T_BASE_LINK @ makers.T_LINK_OPTICAL
    return StereoRig(K_LEFT, D_LEFT, K_RIGHT, D_RIGHT, T, STEREO_SIZE, T_robot_left)


def infos_of(rig, bag, at_ns=0):
    """As camera_calibration writes them."""
    R_left, R_right, P_left, P_right = cv2.stereoRectify(
        *(rig.K_left, rig.D_left, rig.K_right, rig.D_right, rig.size),
        *(rig.T_right_left[:3, :3], rig.T_right_left[:3, 3:]),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )[:4]
    left = bag.info(at_ns, "left", rig.K_left, rig.D_left, R_left, P_left, rig.size)
    return left, bag.info(at_ns, "right", rig.K_right, rig.D_right, R_right, P_right, rig.size)


def test_raw_infos_give_the_rig_back_and_rectified_ones_its_rectified_self(rig, tmp_path):
    with makers.Maker(tmp_path / "bag") as bag:
        left, right = map(camera_info, infos_of(rig, bag))
    back = rig_of(left, right, rectified=False, T_robot_left=rig.T_robot_left)
    assert np.allclose(back.T_right_left, rig.T_right_left, atol=1e-12)
    assert np.array_equal(back.K_left, rig.K_left) and np.array_equal(back.D_right, rig.D_right)
    rectified = rig_of(left, right, rectified=True, T_robot_left=rig.T_robot_left)
    assert rectified.is_rectified and rectified.baseline_m == pytest.approx(rig.baseline_m)
    turned = rectified.T_robot_left[:3, :3].T @ Rectifier(back).T_robot_rectified[:3, :3]
    assert np.allclose(turned, np.eye(3), atol=1e-6), "the same axes as by our own rectification"
    with pytest.raises(CalibrationError, match="baseline"):
        rig_of(right, left, rectified=True, T_robot_left=rig.T_robot_left)


def test_a_bag_of_two_eyes_gives_the_depth_of_a_wall(rig, tmp_path):
    """A textured wall that both eyes see where the rectified rig has it 2 m away."""
    rng = np.random.default_rng(5)
    with makers.Maker(tmp_path / "bag") as bag:
        left, right = infos_of(rig, bag)
        lens = camera_info(left)
        f, baseline_m = lens.P[0, 0], -camera_info(right).sideways_m
        shift = round(f * baseline_m / 2.0)
        width, height = STEREO_SIZE
        wall = cv2.GaussianBlur(rng.integers(0, 256, (height, width + shift), np.uint8), (0, 0), 1)
        for k in range(2):
            at_ns = makers.BEGIN_NS + k * makers.PERIOD_NS
            for side, info, begin in (("left", left, 0), ("right", right, shift)):
                eye = bag.image(wall[:, begin : begin + width], "mono8", at_ns + begin, side)
                bag.put(f"/stereo/{side}/image_rect", eye, at_ns)
                bag.put(f"/stereo/{side}/camera_info", info, at_ns)
    frames = frames_of(tmp_path / "bag")
    assert len(frames) == 2
    for frame in frames:
        assert isinstance(frame.ranges, DisparityImage)
        disparity = frame.ranges.disparity_px
        assert np.nanmedian(disparity) == pytest.approx(shift, abs=0.2)
        assert frame.ranges.focal_baseline_px_m == pytest.approx(f * baseline_m)


def command(*arguments):
    done = CliRunner().invoke(app, list(map(str, arguments)))
    return done.exit_code, done.output


def test_topics_says_what_is_there_which_topics_are_taken_and_what_is_missing(tmp_path):
    path = makers.write_rgbd(tmp_path / "bag", makers.source())
    code, said = command("topics", path)
    assert code == 0
    assert "colour      /r1/camera/color/image_raw (an image without 'depth' in its name)" in said
    assert "10.0 Hz" in said and "6.0 ms, at most 6.0, of 5 pairs; 0 without partner" in said
    assert "base_link -> camera_link -> camera_color_optical_frame (fixed)" in said
    assert f"robot-agent run --name r1 --camera bag --data {path}" in said
    bare = makers.write_rgbd(tmp_path / "bare", makers.source(), static_tf=False)
    code, said = command("topics", bare, "--namespace", "/r1")
    assert code == 0 and "the bag has no tf" in said and said.endswith("--namespace /r1\n")


def test_inspect_knows_a_bag_and_its_command(tmp_path):
    path = makers.write_rgbd(tmp_path / "ros1.bag", makers.source(), ros=1)
    code, said = command("inspect", path)
    assert code == 0 and f"{path} is a bag (--camera bag)" in said
    assert "96x72 px, f 80 px" in said and f"--camera bag --data {path}" in said


def test_a_bag_of_ros_1_that_was_cut_off_says_what_mends_it(tmp_path):
    path = tmp_path / "cut.bag"
    with Writer1(path):
        pass
    path.write_bytes(path.read_bytes()[:13] + b"\0" * 50)
    with pytest.raises(DataFolderError, match=r"cut\.bag cannot be opened"):
        Bag(str(path))


def test_given_bags_are_understood_and_none_ends_the_command():
    folder = shared_data("bags")
    for bag in (*folder.iterdir(), *(folder / "real_ros2_written").iterdir()):
        if bag.suffix == ".txt":
            continue
        code, said = command("topics", bag)
        assert code == 0, said
        if bag.name.startswith("robot_"):
            assert "aligned_depth_to_color/image_raw" in said and "of 2 pairs; 0 without" in said
