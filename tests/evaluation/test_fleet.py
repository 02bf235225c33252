"""`pose-eval fleet` shares a recording among live robots and knows what each of them sees."""

import json
import random

import pytest

from fleetpose.evaluation.data.opening import open_recording
from fleetpose.evaluation.data.parts import parts_of
from fleetpose.evaluation.system.fleet import FleetOptions, named_skip_pairs, plan_fleet, run
from fleetpose.evaluation.system.observer import SeenView, digest_of
from fleetpose.protocol.errors import DataFolderError, FleetPoseError
from fleetpose.protocol.keys import new_epoch
from fleetpose.protocol.messages import View, ViewName
from tests.data import shared_data
from tests.evaluation.makers import write_posed_views, write_rgbd


def test_posed_views_are_consecutive_by_ring_angle_and_the_ring_closes(tmp_path):
    write_posed_views(tmp_path / "set", count=6)  # angles 180, 190, ... 230
    recording = open_recording(tmp_path / "set", "sparse")
    parts = parts_of(recording, 3, first=4)
    assert [[view.index for view in part] for part in parts] == [[4], [5], [0]]


def test_rgbd_frames_are_shared_in_equal_contiguous_stretches(tmp_path):
    write_rgbd(tmp_path / "set", count=7)
    parts = parts_of(open_recording(tmp_path / "set"), 3, first=0)
    assert [[view.index for view in part] for part in parts] == [[0, 1], [2, 3], [4, 5]]


def test_too_many_robots_are_refused(tmp_path):
    write_posed_views(tmp_path / "views", count=3)
    write_rgbd(tmp_path / "rgbd", count=3)
    for name, clouds in (("views", "sparse"), ("rgbd", None)):
        with pytest.raises(DataFolderError):
            parts_of(open_recording(tmp_path / name, clouds), 4, first=0)


def test_views_of_no_recording_are_refused(tmp_path):
    with pytest.raises(DataFolderError, match="--data"):
        plan_fleet(FleetOptions(robots=2, seconds=30, views=(0, 1)), tmp_path)


def test_skip_pairs_are_told_by_the_robots_random_names(tmp_path):
    (tmp_path / "skip").write_text("r1 r3\n\nr2 r1\n")
    named = named_skip_pairs(tmp_path / "skip", ["rxyz", "rabc", "rqqq"], tmp_path)
    assert named is not None
    assert named.read_text().splitlines() == ["rxyz rqqq", "rabc rxyz"]
    assert named_skip_pairs(None, ["ra"], tmp_path) is None


@pytest.mark.parametrize("text", ["r1 r9", "r1", "r1 r2 r3"])
def test_skip_pairs_that_make_no_sense_are_refused(tmp_path, text):
    (tmp_path / "skip").write_text(text)
    with pytest.raises(DataFolderError, match="skip-pairs"):
        named_skip_pairs(tmp_path / "skip", ["ra", "rb"], tmp_path)


def sent_by(folder, robot: str) -> list[SeenView]:
    """The views that an agent with this folder would send."""
    from fleetpose.robot_agent.cameras.factory import open_camera
    from fleetpose.robot_agent.features.keypoints import salient_points
    from fleetpose.robot_agent.features.packing import view_of

    views = []
    camera = open_camera(folder.camera, folder.data, "once")
    for seq, frame in enumerate(camera.frames()):
        name = ViewName(robot=robot, epoch=new_epoch(), seq=seq)
        salient = salient_points(frame.image, frame.ranges, frame.model)
        view = view_of(name, frame, salient)
        assert isinstance(view, View)
        views.append(SeenView(view, digest_of(view.cloud), 0.0, 0))
    return views


@pytest.mark.parametrize("rgbd", [False, True], ids=["views", "rgbd"])
def test_the_true_pose_of_a_view_is_known_by_its_cloud(tmp_path, rgbd):
    if rgbd:
        poses = write_rgbd(tmp_path / "set", count=4)
        options = FleetOptions(robots=2, seconds=30, data=(tmp_path / "set",))
    else:
        poses = write_posed_views(tmp_path / "set", count=2)
        options = FleetOptions(robots=2, seconds=30, data=(tmp_path / "set",), clouds="sparse")
    plan = plan_fleet(options, tmp_path / "scratch")
    found = []
    for robot in plan.robots:
        for seen in sent_by(robot, robot.name):
            T_world_robot = plan.truth.T_world_robot(seen)
            assert T_world_robot is not None
            found.append(T_world_robot @ seen.view.camera.T_robot_camera)
    for T_world_camera, true in zip(found, poses, strict=True):
        assert T_world_camera == pytest.approx(true, abs=1e-9)


@pytest.mark.parametrize("rgbd", [False, True], ids=["views", "rgbd"])
def test_one_robot_stands_at_each_view_that_is_named(tmp_path, rgbd):
    poses = (write_rgbd if rgbd else write_posed_views)(tmp_path / "set", count=5)
    options = FleetOptions(robots=9, seconds=30, data=(tmp_path / "set",), views=(4, 0, 2))
    plan = plan_fleet(options, tmp_path / "scratch")
    assert all(robot.options == ("--replay", "hold") for robot in plan.robots)
    for robot, index in zip(plan.robots, (4, 0, 2), strict=True):
        (seen,) = sent_by(robot, robot.name)
        T_world_robot = plan.truth.T_world_robot(seen)
        assert T_world_robot is not None
        assert T_world_robot @ seen.view.camera.T_robot_camera == pytest.approx(poses[index])


def test_views_of_posed_views_show_the_operator_what_they_share(tmp_path):
    write_posed_views(tmp_path / "set", count=2, points=300)
    options = FleetOptions(robots=2, seconds=30, data=(tmp_path / "set",), clouds="sparse_noisy")
    plan = plan_fleet(options, tmp_path / "scratch")
    i, j = (sent_by(robot, robot.name)[0] for robot in plan.robots)
    uv_i, uv_j = plan.truth.correspondences(i, j)
    assert len(uv_i) == len(uv_j) == 280
    assert plan.truth.see_the_same(i, j)


def test_robots_names_say_nothing_about_their_order():
    from fleetpose.evaluation.system.fleet import distinct_names

    names = distinct_names(40, random.Random(3))
    assert len(set(names)) == 40
    assert names != sorted(names)


def test_too_short_a_run_is_refused(tmp_path):
    with pytest.raises(FleetPoseError, match="from 20 s on"):
        run(FleetOptions(robots=2, seconds=20), tmp_path / "out")


def test_a_live_fleet_on_recorded_views_is_scored(tmp_path):
    """Two robots side by side: everything from start to summary, with real processes."""
    options = FleetOptions(
        robots=2, seconds=24, data=(shared_data("church_herzjesu"),), clouds="sparse_noisy", first=4
    )
    summary = run(options, tmp_path / "out")
    assert summary["robots"] == 2
    assert summary["leftover_processes"] == 0
    assert summary["undecodable"] == 0
    assert summary["grave_located"] == 0
    assert summary["samples"] == 5
    assert summary["bytes_per_view"] > 10_000
    assert summary["agent_rss_mb"] > 10
    assert summary["server_rss_mb"] > 10
    written = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert written["median_depth_m"] == pytest.approx(14.1, abs=0.1)
    rows = (tmp_path / "out" / "poses.csv").read_text().splitlines()
    assert len(rows) == 1 + 2 * 5
    assert (tmp_path / "out" / "map.png").exists()
