"""Witnesses that disagree: who is not believed, what is said of it, and when it is believed again;
without network and workers.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.consistency.blindness import blind_alarms
from fleetpose.pose_server.geometry.se3 import inverse, make_pose
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.questions.facts import questions
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.protocol.clouds import (
    decode_salient,
    decode_scattered,
    encode_salient,
    encode_scattered,
)
from fleetpose.protocol.messages import Odometry, RobotState, View, ViewName
from fleetpose.robot_agent.features.keypoints import EXTRACTOR
from tests.pose_server.scene import EPOCH, descriptors, turned, view, walls
from tests.pose_server.test_flows import kept, site_of, work_off

LATER = "1" * 12
SMALL = np.eye(6) * 1e-6
SETTINGS = ServerSettings()
HALL, OTHER_HALL = 3, 4
PLACES = {"r1": np.eye(4), "r2": inverse(turned(12)), "r3": inverse(turned(24))}


def seen(
    robot: str,
    seq: int,
    at: np.ndarray | None = None,
    hall: int = HALL,
    epoch: str = EPOCH,
    content: int | None = None,
) -> View:
    """What a robot sees in a hall from its place there, or from another one (T_camera_scene), one
    second after its view before.

    Args:
        content: the same number gives the same view to the last bit.
    """
    rng = np.random.default_rng(hall)
    points, looks = walls(rng, 800), descriptors(rng, 800)
    T = PLACES[robot] if at is None else at
    rng = np.random.default_rng((hall, ord(robot[1]), seq if content is None else content))
    name = ViewName(robot=robot, epoch=epoch, seq=seq)
    made = view(rng, robot, points, looks, T, seq=seq)
    return made.model_copy(update={"name": name, "stamp_ns": seq * 10**9})


def receive(site: Site, *views: View, at_s: float | None = None) -> None:
    """Views arrive at a time, that of their stamps if it is not given; then what they lead to."""
    for one in views:
        now_s = 1e-9 * one.stamp_ns if at_s is None else at_s
        pipeline.receive_token(site, one.name.robot, one.name.epoch, True)
        pipeline.receive_view(site, kept(one, now_s))
    work_off(site, most=60)
    pipeline.note_components(site)


def fleet(robots: Sequence[str] = ("r1", "r2", "r3")) -> Site:
    """Robots that see the same, all located."""
    site = site_of()
    receive(site, *(seen(robot, 0) for robot in robots))
    assert all(state_of(site, robot, 0.0).why_not == "" for robot in robots)
    return site


def state_of(site: Site, robot: str, now_s: float) -> RobotState:
    """What is published of a robot at a time."""
    while site.dirty:
        pipeline.solve(site, now_s)
    stamp = builders.Stamp("0" * 12, now_s, int(1e9 * now_s))
    for one in site.robots.values():
        if (found := builders.robot_pose(site, one, SETTINGS, stamp)) is not None:
            one.publish(*found)
    state = builders.fleet_state(site, SETTINGS, stamp, 1)
    return next(one for one in state.robots if one.robot == robot)


def alarms(site: Site) -> set[tuple[str, str]]:
    stamp = builders.Stamp("0" * 12, 0.0, 0)
    state = builders.fleet_state(site, SETTINGS, stamp, 1)
    return {(alarm.robot, alarm.kind) for alarm in state.alarms}


def drive(site: Site, robot: str, seq: int, forward_m: float, epoch: str = EPOCH) -> None:
    """What a robot's wheels say at the moment of a view."""
    T = make_pose(np.eye(3), np.array([forward_m, 0.0, 0.0]))
    site.odometers.note(
        Odometry(robot=robot, epoch=epoch, stamp_ns=seq * 10**9, T_odom_robot=T, covariance=SMALL)
    )


@pytest.mark.parametrize("identical", [True, False], ids=["frozen", "sees what moves with it"])
def test_pixels_that_stand_still_while_odometry_drives_refute_both(identical):
    site = fleet()
    for seq in range(1, 4):
        drive(site, "r2", seq, 0.0)
        receive(site, seen("r2", seq, content=9 if identical else None))
    assert not alarms(site) and state_of(site, "r2", 3.0).pose.located
    believed = site.robots["r2"].track.newest.view
    for seq in range(4, 7):
        drive(site, "r2", seq, 0.5 * (seq - 3))
        receive(site, seen("r2", seq, content=9 if identical else None))
    state = state_of(site, "r2", 6.0)
    assert alarms(site) == {("r2", "still")} and not state.pose.located
    assert "pixels of r2 stand still while its odometry drove 1.5 m" in state.why_not
    assert site.robots["r2"].track.newest.view == believed, "it hangs nowhere while it is doubted"
    assert all(state_of(site, other, 0.0).why_not == "" for other in ("r1", "r3"))
    moved = inverse(turned(14))
    receive(site, seen("r2", 7, at=moved))
    assert not alarms(site) and state_of(site, "r2", 7.0).why_not == ""


def test_a_robot_that_sets_off_later_in_its_pixels_than_by_its_wheels_is_no_fault():
    site = fleet()
    drive(site, "r2", 0, 0.0)
    site.odometers.at(ViewName(robot="r2", epoch=EPOCH, seq=0), 0)
    drive(site, "r2", 1, 0.4)
    receive(site, seen("r2", 1))
    assert not alarms(site)
    T = make_pose(np.eye(3), np.array([0.0, 0.0, -0.4]))
    drive(site, "r2", 2, 0.8)
    receive(site, seen("r2", 2, at=T @ PLACES["r2"]))
    assert not alarms(site) and state_of(site, "r2", 2.0).why_not == ""


def test_what_stands_still_for_ever_or_drifts_slowly_is_no_fault():
    site = fleet()
    for seq in range(1, 20):
        drive(site, "r2", seq, 0.005 * seq)  # half a centimetre a second: 5 cm in ten
        receive(site, seen("r2", seq, content=9), seen("r3", seq, content=9))
    assert not alarms(site)
    assert state_of(site, "r2", 19.0).why_not == state_of(site, "r3", 19.0).why_not == ""


def test_wheels_that_come_back_to_where_the_pixels_stood_agree_again():
    site = fleet()
    for seq, forward_m in enumerate((0.0, 1.0, 2.0, 1.0, 0.0)):
        drive(site, "r2", seq, forward_m)
        receive(site, seen("r2", seq))
    assert not alarms(site) and state_of(site, "r2", 4.0).why_not == ""


def test_odometry_that_falls_silent_contradicts_nobody():
    site = fleet()
    drive(site, "r2", 1, 0.0)
    receive(site, seen("r2", 1))
    drive(site, "r2", 2, 1.0)
    receive(site, seen("r2", 2), seen("r2", 3), seen("r2", 4))
    assert not alarms(site) and state_of(site, "r2", 4.0).why_not == ""


def test_a_robot_that_drove_blindly_and_was_started_anew_is_not_believed_for_the_same_pixels():
    """What moves with it looks as it did; the odometry of the new life begins at nought."""
    site = fleet()
    for seq in range(4):
        drive(site, "r2", seq, 1.0 * seq)
        receive(site, seen("r2", seq + 1).model_copy(update={"stamp_ns": seq * 10**9}), at_s=seq)
    assert alarms(site) == {("r2", "still")}
    pipeline.receive_token(site, "r2", EPOCH, False)
    drive(site, "r2", 6, 0.0, epoch=LATER)
    receive(site, seen("r2", 6, epoch=LATER))
    assert alarms(site) == {("r2", "still")} and not state_of(site, "r2", 6.0).pose.located


def test_a_camera_that_repeats_itself_by_its_own_word_is_named_and_not_believed():
    site = fleet()
    frozen = {"frozen_s": 2.5}
    receive(site, seen("r2", 1, content=9), seen("r2", 2, content=9).model_copy(update=frozen))
    state = state_of(site, "r2", 2.0)
    assert alarms(site) == {("r2", "frozen")} and not state.pose.located
    assert "identical to the last bit" in state.why_not
    receive(site, seen("r2", 3))
    assert not alarms(site) and state_of(site, "r2", 3.0).why_not == ""


def test_a_robot_that_loses_nearly_all_its_depth_is_named_and_not_asked_about():
    site = fleet()
    points = decode_salient(seen("r2", 1).salient)
    usual = len(points.uv)
    left = np.where(np.arange(usual) % 33, np.nan, points.inverse_depth).astype(np.float32)
    few = encode_salient(replace(points, inverse_depth=left), EXTRACTOR)
    receive(site, seen("r2", 1).model_copy(update={"salient": few}))
    assert ("r2", "blind") not in alarms(site), "its cloud has enough to click at"
    uv, z = decode_scattered(seen("r2", 2).cloud)
    thin = encode_scattered(uv[::33], z[::33], 1e-3)
    receive(site, seen("r2", 2).model_copy(update={"salient": few, "cloud": thin}))
    assert ("r2", "blind") in alarms(site)
    (alarm,) = (one for one in blind_alarms(site) if one.robot == "r2")
    assert f"({np.isfinite(left).sum()} points where its keyframes have up to" in alarm.text
    assert not any("r2" in (q.i, q.j) for q in questions(site))
    receive(site, seen("r2", 3))
    assert ("r2", "blind") not in alarms(site)
    assert sum("hardly anything" in event for event in site.events) == 1


@pytest.mark.parametrize("wheels", [False, True], ids=["no odometry", "wheels at rest"])
def test_a_robot_that_is_carried_away_is_told_and_found_again_when_it_returns(wheels):
    site = fleet()
    for seq in range(1, 3):
        if wheels:
            drive(site, "r2", seq, 0.0)
        receive(site, seen("r2", seq, hall=HALL if seq < 2 else OTHER_HALL))
    state = state_of(site, "r2", 2.0)
    assert alarms(site) == {("r2", "lost")} and "carried or covered?" in state.why_not
    assert state.pose is None or not state.pose.located
    assert all(state_of(site, other, 0.0).why_not == "" for other in ("r1", "r3"))
    receive(site, seen("r2", 3))
    assert not alarms(site) and state_of(site, "r2", 3.0).why_not == ""
    assert "r2 sees something known again" in site.events


def test_a_robot_that_is_carried_to_what_another_one_sees_is_found_there():
    site = fleet()
    receive(site, seen("r3", 1, hall=OTHER_HALL))
    assert alarms(site) == {("r3", "lost")}
    receive(site, seen("r3", 2, at=inverse(turned(-12))))
    assert not alarms(site)
    state = state_of(site, "r3", 2.0)
    assert state.why_not == ""
    T = inverse(state_of(site, "r1", 2.0).pose.T_fleet_robot) @ state.pose.T_fleet_robot
    assert np.degrees(np.arccos((np.trace(T[:3, :3]) - 1) / 2)) == pytest.approx(12, abs=1)


def test_a_robot_started_anew_elsewhere_is_not_where_it_was():
    site = fleet()
    pipeline.receive_token(site, "r2", EPOCH, False)
    pipeline.receive_token(site, "r2", LATER, True)
    anew = state_of(site, "r2", 1.0)
    assert not anew.pose.located and "started anew" in anew.why_not
    receive(site, seen("r2", 1, hall=OTHER_HALL, epoch=LATER))
    state = state_of(site, "r2", 1.0)
    assert alarms(site) == {("r2", "carried")} and "Where it was counts no more" in state.why_not
    assert not state.pose.located
    receive(site, seen("r2", 2, epoch=LATER))
    assert not alarms(site) and state_of(site, "r2", 2.0).why_not == ""


def recognised_as(verdict: str, site: Site, epoch: str) -> None:
    """r2 sees something new, and all its alignments with what it saw before end in a verdict."""
    pipeline.receive_token(site, "r2", epoch, True)
    pipeline.receive_view(site, kept(seen("r2", 1, hall=OTHER_HALL, epoch=epoch), 1.0))
    for _ in range(60):
        while site.dirty:
            pipeline.solve(site, 1.0)
        job = pipeline.next_job(site, 1.0)
        if job is None:
            break
        own = job.i.name.robot == job.j.name.robot
        result = PairResult(np.eye(4), np.eye(6) * 1e-6, verdict, (), inliers=50, overlap=0.9)
        refused = replace(result, verdict="rejected")
        pipeline.take_result(site, Done(job, result if own else refused), 1.0)


@pytest.mark.parametrize(("verdict", "joined"), [("plausible", False), ("verified", True)])
def test_a_new_life_must_be_recognised_beyond_doubt_by_its_own_keyframes(verdict, joined):
    """Being the same robot is no evidence of being at the same place."""
    site = fleet()
    pipeline.receive_token(site, "r2", EPOCH, False)
    recognised_as(verdict, site, LATER)
    state = state_of(site, "r2", 1.0)
    assert (state.why_not == "") == joined
    assert (
        site.joined(*(ViewName(robot="r2", epoch=e, seq=k) for k, e in enumerate((EPOCH, LATER))))
        == joined
    )


def test_a_robot_that_leaves_takes_nobody_with_it():
    site = fleet()
    pipeline.receive_token(site, "r2", EPOCH, False)
    assert "r2 is gone" in site.events
    assert "token is gone" in state_of(site, "r2", 1.0).why_not
    assert all(state_of(site, other, 1.0).why_not == "" for other in ("r1", "r3"))
