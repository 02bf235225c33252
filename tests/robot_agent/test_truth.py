"""What a robot's own program may act on: the live server's word, while it is fresh, by the
robot's monotonic clock; and in words why not.
"""

import logging
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RelativePose, RobotPose, WhyNot
from fleetpose.protocol.transport import Answer, Link, Sample, open_session, wait_until
from fleetpose.robot_agent import client as client_module
from fleetpose.robot_agent import hearing
from fleetpose.robot_agent import poses as poses_module
from fleetpose.robot_agent.client import FleetRobot
from fleetpose.robot_agent.poses import PoseBoard
from tests.robot_agent.test_client import (
    DEPTH,
    IMAGE,
    KEYS,
    MODEL,
    pose_message,
    pose_publisher,
    publish,
    settings_for,
)

LIVE, OTHER = "0" * 12, "f" * 12


@pytest.fixture
def robot(router):
    with FleetRobot("r1", settings_for(router), camera=MODEL) as opened:
        yield opened


@pytest.fixture
def elsewhere(router):
    """A link of another process."""
    opened = Link(open_session(settings_for(router)))
    yield opened
    opened.close()


# ---- whose poses ---------------------------------------------------------------------------------


def test_a_pose_of_another_epoch_than_the_live_servers_is_refused_counted_and_named(
    robot, link, elsewhere, caplog
):
    server = pose_publisher(link)
    assert wait_until(lambda: robot.server_alive, 30)
    publish(server, pose_message(n=1, x_m=1.0))
    assert wait_until(lambda: robot.pose() is not None, 30)
    liar = elsewhere.latched(KEYS.pose("r1"))
    forged = pose_message(n=9, server_epoch=OTHER, x_m=100.0, valid_for_s=3600.0)
    with caplog.at_level(logging.WARNING):
        publish(liar, forged)
        assert wait_until(lambda: robot.drops.total() == 1, 30)
    assert robot.drops == {"a pose of server _ that is not alive": 1}
    assert f"a pose of server {OTHER} that is not alive: alive is {LIVE}" in caplog.text
    assert robot.pose().T_fleet_robot[0, 3] == 1.0 and not robot.is_stale(robot.pose())
    assert robot.is_stale(forged)
    publish(server, pose_message(n=2, x_m=2.0))
    assert wait_until(lambda: robot.pose().n == 2, 30)


def test_without_a_server_nobodys_pose_is_taken(robot, elsewhere):
    publish(elsewhere.latched(KEYS.pose("r1")), pose_message(server_epoch=OTHER))
    assert wait_until(lambda: robot.drops.total() == 1, 30)
    assert robot.pose() is None and not robot.server_alive


def test_poses_that_were_there_before_the_robot_are_taken(router, link):
    server = pose_publisher(link)
    publish(server, pose_message(n=3))
    with FleetRobot("r1", settings_for(router)) as late:
        assert wait_until(lambda: late.pose() is not None, 30)
        assert late.server_alive and late.drops == {}


def test_poses_of_a_server_that_was_replaced_are_stale_at_once(robot, link, elsewhere):
    server = pose_publisher(link)
    assert wait_until(lambda: robot.server_alive, 30)
    publish(server, pose_message())
    assert wait_until(lambda: robot.pose() is not None, 30)
    pose = robot.pose()
    link.close()
    assert wait_until(lambda: not robot.server_alive, 30)
    assert not robot.is_stale(pose)  # nobody says otherwise: it is as good as it was
    elsewhere.token(KEYS.server_alive(OTHER))
    assert wait_until(lambda: robot.is_stale(pose) and robot.server_alive, 30)
    publish(elsewhere.latched(KEYS.pose("r1")), pose_message(server_epoch=OTHER, n=0))
    assert wait_until(lambda: not robot.is_stale(robot.pose()), 30)


# ---- for how long --------------------------------------------------------------------------------


class Server:
    """One that lives, and perhaps another one later."""

    epoch = LIVE

    def check(self, epoch, what):
        assert epoch == self.epoch, what


def new_board():
    opened = PoseBoard(Keys("demo"), Drops(), Server())
    opened.close()  # the tests apply samples themselves
    return opened


@pytest.fixture
def board():
    return new_board()


def received(board, pose, at_s):
    board._apply(Sample(KEYS.pose(pose.robot), pack(pose), encoding_of(RobotPose)), at_s)
    return pose


@given(
    age_s=st.floats(0.0, 20.0),
    lives_s=st.floats(0.0, 20.0),
    later_s=st.floats(0.0, 40.0),
    step_s=st.floats(-1e6, 1e6),
)
def test_a_pose_is_valid_for_what_is_left_of_its_time_from_its_arrival_whatever_wall_clocks_do(
    age_s, lives_s, later_s, step_s
):
    board, stamp_ns = new_board(), time.time_ns() + int(step_s * 1e9)
    pose = pose_message().model_copy(
        update={
            "age_s": age_s,
            "stamp_ns": stamp_ns,
            "valid_until_ns": stamp_ns + int(lives_s * 1e9),
        }
    )
    received(board, pose, at_s=time.monotonic() - later_s)
    left_s = max(lives_s - age_s, 0.0) - later_s
    if abs(left_s) > 0.5:
        assert board.is_valid(pose) == (left_s > 0)


def test_a_dead_servers_pose_goes_stale_though_the_wall_clock_steps_back(board, monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr(poses_module.time, "monotonic", lambda: clock[0])
    pose = received(board, pose_message(), at_s=clock[0])
    board._server.epoch = None  # it died
    monkeypatch.setattr(time, "time_ns", lambda: pose.stamp_ns - 60 * 10**9)
    clock[0] += 4.0
    assert board.is_valid(pose)
    clock[0] += 1.0  # it was 0.5 s old when it was sent, and 5 s are all
    assert not board.is_valid(pose)


def test_an_older_pose_that_a_program_still_holds_has_its_own_time(board, monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr(poses_module.time, "monotonic", lambda: clock[0])
    first = received(board, pose_message(n=1), at_s=clock[0])
    clock[0] += 3.0
    second = received(board, pose_message(n=2), at_s=clock[0])
    assert board.is_valid(first) and board.is_valid(second)
    clock[0] += 2.0
    assert not board.is_valid(first) and board.is_valid(second)


def test_what_never_arrived_is_stale(robot):
    assert robot.is_stale(pose_message(valid_for_s=3600.0))


def test_times_of_poses_that_are_over_are_forgotten(board):
    for n in range(1000):
        received(board, pose_message(n=n), at_s=10.0 * n)
    assert len(board._valid_until_s["r1"]) == 1


# ---- why not -------------------------------------------------------------------------------------


def test_a_program_reads_why_its_robot_is_not_located(robot, link):
    words = "its token is gone", "r1's depths are 5 % too long: check its baseline"

    def answer(asked):
        told = WhyNot(robot=asked["robot"], located=False, why_not=words[0], alarms=words[1:])
        return Answer(pack(told), encoding_of(WhyNot))

    link.queryable(KEYS.why, answer)
    link.token(KEYS.server_alive(LIVE))
    assert wait_until(lambda: robot.server_alive, 30)
    assert wait_until(lambda: robot.why(1.0) == "; ".join(words), 30)


def test_a_server_that_does_not_know_the_robot_says_so(robot, link):
    link.queryable(KEYS.why, lambda _: Answer(error="no robot 'r1' is known; known are: r2"))
    link.token(KEYS.server_alive(LIVE))
    assert wait_until(lambda: robot.server_alive, 30)
    assert wait_until(lambda: "no robot 'r1' is known" in robot.why(1.0), 30)


def test_a_mistyped_site_is_told_and_the_right_one_named(router, link, caplog, monkeypatch):
    monkeypatch.setattr(hearing, "UNHEARD_S", 0.2)
    caplog.set_level(logging.INFO)
    link.token(KEYS.server_alive(LIVE))
    with FleetRobot("r1", settings_for(router), site="dmeo", camera=MODEL) as lost:
        assert not lost.server_alive
        why = lost.why()
        assert "no server at site 'dmeo': is the site name right" in why
        assert "There is one at demo." in why

        def logged():
            lost.push(IMAGE, DEPTH)
            return caplog.text.count("no server at site 'dmeo'")

        assert wait_until(lambda: logged() == 1, 30)
        assert "There is one at demo." in caplog.text
        assert [logged() for _ in range(5)] == [1] * 5  # once a minute
        with pytest.raises(client_module.UnreachableError, match="is the site name right"):
            lost.relative_pose("r2", timeout_s=1)


def test_a_lost_router_is_told_from_a_site_without_a_server(own_router):
    with FleetRobot("r1", settings_for(own_router.endpoint)) as robot:
        assert "no server at site" in robot.why()
        own_router.close()
        assert wait_until(lambda: "no router is reached" in robot.why(), 30)
        own_router.start()
        assert wait_until(lambda: "no server at site" in robot.why(), 30)


def test_a_relative_pose_carries_whether_it_may_be_acted_on(robot, link):
    told = RelativePose(
        a="r1",
        b="r2",
        T_a_b=np.eye(4),
        covariance=np.eye(6),
        age_s=30.0,
        through=(),
        verdict="plausible",
        located=False,
        p_grave=0.1,
        why_not="r2: its token is gone",
    )
    link.queryable(KEYS.relative, lambda _: Answer(pack(told), encoding_of(RelativePose)))
    link.token(KEYS.server_alive(LIVE))

    def asked():
        try:
            return robot.relative_pose("r2", 1.0)
        except client_module.UnreachableError:
            return None

    assert wait_until(lambda: asked() is not None, 30)
    pose = asked()
    assert (pose.located, pose.why_not, pose.p_grave) == (False, "r2: its token is gone", 0.1)
