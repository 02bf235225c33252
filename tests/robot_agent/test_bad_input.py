"""Bad poses are counted and change nothing; bad files stop with a sentence, never a traceback."""

import json
import logging

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CalibrationError, FleetPoseError, UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RelativePose, RobotPose
from fleetpose.protocol.transport import Answer, Sample, wait_until
from fleetpose.robot_agent import poses as poses_module
from fleetpose.robot_agent.cameras.calibrations.reading import rig_of
from fleetpose.robot_agent.cameras.stereo.rig import content_of
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.poses import PoseBoard
from fleetpose.robot_agent.settings import RobotSettings
from tests.robot_agent.test_client import (
    DEPTH,
    IMAGE,
    KEYS,
    pose_message,
    settings_for,
)
from tests.robot_agent.test_recordings import frames_of
from tests.robot_agent.test_stereo import rectified_rig

few = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
ENCODING = encoding_of(RobotPose)
junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=6,
)


class AnyServer:
    """Every epoch is the live server's."""

    epoch = None

    def check(self, epoch, what):
        pass


@pytest.fixture
def board():
    opened = PoseBoard(Keys("demo"), Drops(), AnyServer())
    yield opened
    opened.close()


def sample(pose, key="fleet/demo/pose/r1"):
    return Sample(key, pack(pose), ENCODING)


# ---- poses ---------------------------------------------------------------------------------------


@few
@given(bad=st.binary(max_size=200))
def test_any_bytes_are_one_drop_and_no_pose(board, bad):
    before = board._drops.total()
    board.store(Sample("fleet/demo/pose/r1", bad, ENCODING))
    assert wait_until(lambda: board._drops.total() == before + 1, 5, poll_s=0.001)
    assert board.newest() == {}


def test_a_pose_under_another_robots_key_is_refused(board, caplog):
    with caplog.at_level(logging.WARNING):
        for n in range(5):
            board.store(sample(pose_message(n=n), "fleet/demo/pose/r2"))
        assert wait_until(lambda: board._drops.total() == 5, 30)
    assert board.newest() == {} and len(caplog.records) == 1


def test_a_hostile_number_hides_no_later_life_of_the_server(board):
    board.store(sample(pose_message(n=2**62)))
    board.store(sample(pose_message(n=1, server_epoch="1" * 12)))
    assert wait_until(lambda: board.newest() and board.newest()["r1"].pose.n == 1, 30)


def test_invented_robots_fill_no_memory(board, monkeypatch):
    monkeypatch.setattr(poses_module, "MAX_ROBOTS", 3)
    for k in range(6):
        board.store(sample(pose_message(robot=f"x{k}"), f"fleet/demo/pose/x{k}"))
    assert wait_until(lambda: board._drops.total() == 3, 30)
    assert len(board.newest()) == 3


def test_poses_that_come_faster_than_they_are_read_are_counted(monkeypatch):
    monkeypatch.setattr(poses_module, "MAX_WAITING", 4)
    board = PoseBoard(Keys("demo"), Drops(), AnyServer())
    board.close()
    for n in range(10):
        board.store(sample(pose_message(n=n)))
    assert board._drops == {"more poses than can be read": 6}


def test_a_damaged_or_garbled_answer_of_the_server_is_an_error_of_its_own(router, link):
    answers = [
        Answer(b"\xc1", encoding_of(RelativePose)),
        Answer(error="no \x1b[2J\nFORGED"),
    ]
    link.queryable(KEYS.relative, lambda _: answers[0])
    with FleetRobot("r1", settings_for(router)) as robot:
        assert wait_until(lambda: "msgpack" in _why(robot), 30)
        assert robot.drops["not msgpack"] >= 1
        answers.pop(0)
        assert "no  [2J FORGED" in _why(robot)


def _why(robot):
    try:
        robot.relative_pose("r2", timeout_s=1)
    except (FleetPoseError, UnreachableError) as error:
        return str(error)
    return ""


# ---- what is pushed ------------------------------------------------------------------------------


@pytest.mark.parametrize("up", [np.zeros(3), np.array([0.0, -9.81, 0.0]), np.full(3, np.nan)])
def test_up_that_is_no_unit_vector_is_refused_at_once(router, up):
    from tests.robot_agent.test_client import MODEL

    with (
        FleetRobot("r1", settings_for(router), camera=MODEL) as robot,
        pytest.raises(CalibrationError, match="unit vector"),
    ):
        robot.push(IMAGE, DEPTH, up_camera=up)


# ---- files ---------------------------------------------------------------------------------------


@few
@given(
    changes=st.dictionaries(st.sampled_from(sorted(content_of(rectified_rig()))), junk, min_size=1)
)
def test_any_rig_file_is_a_rig_or_refused_with_a_sentence(changes):
    content = content_of(rectified_rig()) | changes
    try:
        rig = rig_of(content, "here")
    except CalibrationError as error:
        assert str(error).startswith("here")
        return
    assert np.isfinite(rig.K_left).all() and rig.baseline_m > 0


@few
@example(content={"config": 1})
@given(content=st.dictionaries(st.sampled_from(sorted(RobotSettings.model_fields)), junk))
def test_any_settings_file_is_read_or_refused_with_a_sentence(tmp_path, content):
    file = tmp_path / "settings.toml"
    lines = (f"{name} = {json.dumps(value)}" for name, value in content.items())
    file.write_text("\n".join(lines))
    try:
        loaded = RobotSettings.load(file, {"name": "r1", "camera": "rgbd"})
    except FleetPoseError as error:
        assert "setting" in str(error)
        return
    assert loaded.rate_hz > 0


@few
@given(text=st.text(max_size=80) | st.from_regex(r"([-0-9e.]{1,9} ){9}", fullmatch=True))
def test_any_intrinsics_file_is_a_camera_or_refused_with_a_sentence(tmp_path_factory, text):
    import cv2

    from tests.robot_agent.test_recordings import depth_mm, picture

    folder = tmp_path_factory.mktemp("rgbd")
    cv2.imwrite(str(folder / "frame-000000.color_registered.jpg"), picture(3))
    cv2.imwrite(str(folder / "frame-000000.depth.png"), depth_mm())
    (folder / "camera-intrinsics.txt").write_text(text, encoding="utf-8")
    try:
        (frame,) = frames_of("rgbd", folder)
    except CalibrationError as error:
        assert str(folder) in str(error)
        return
    assert np.isfinite(frame.model.K).all()
