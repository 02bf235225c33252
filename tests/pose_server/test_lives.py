"""Robots that come, go and come back; views that operators hold; clicks in views of the past."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.frontend.frames import position_sigma
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.persistence.graph_writer import graph_of
from fleetpose.pose_server.persistence.restore import restore
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.scheduling.pair_queue import compare_some
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.pairs import PairStatus
from fleetpose.pose_server.state.site import MAX_HELD_BACK, PINNED_S, Site
from fleetpose.pose_server.workers.jobs import ClickJob, Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import Selection, ViewName
from tests.pose_server.scene import EPOCH, descriptors, turned, view, walls
from tests.pose_server.test_flows import click, kept, named, scene_with_points_to_click, site_of
from tests.pose_server.test_flows import work_off as work_off_all

LATER = "1" * 12
SETTINGS = ServerSettings()


def messages(*T_camera_scenes: np.ndarray, robot: str = "r1", epoch: str = EPOCH):
    """Views of one scene, numbered from 0."""
    rng = np.random.default_rng(3)
    points, looks = walls(rng, 1500), descriptors(rng, 1500)
    found = []
    for seq, T in enumerate(T_camera_scenes):
        one = view(rng, robot, points, looks, T, seq=seq)
        found.append(one.model_copy(update={"name": ViewName(robot=robot, epoch=epoch, seq=seq)}))
    return found


def empty_site() -> Site:
    return site_of()


def test_a_view_waits_for_its_robots_token_and_no_token_is_no_robot():
    site = empty_site()
    (first,) = messages(np.eye(4))
    pipeline.receive_view(site, kept(first))
    assert not site.robots and first.name not in site.views
    pipeline.receive_token(site, "r1", EPOCH, True)
    assert site.robots["r1"].newest == first.name and first.name in site.views


def test_views_without_tokens_are_bounded_and_counted():
    site = empty_site()
    (first,) = messages(np.eye(4))
    for number in range(MAX_HELD_BACK + 5):
        name = ViewName(robot=f"ghost-{number}", epoch=EPOCH, seq=0)
        pipeline.receive_view(site, kept(first.model_copy(update={"name": name})))
    assert len(site.held_back) == MAX_HELD_BACK
    assert site.counts["without_token"] == 5


def test_only_the_live_epoch_counts_and_the_last_token_is_the_live_one():
    (old,) = messages(np.eye(4))
    (new,) = messages(np.eye(4), epoch=LATER)
    site = site_of(old)
    with pytest.raises(CodecError, match="lives in"):
        pipeline.receive_view(site, kept(new))
    pipeline.receive_token(site, "r1", LATER, True)  # it took the name over
    pipeline.receive_view(site, kept(new))
    assert site.robots["r1"].newest == new.name
    with pytest.raises(CodecError, match="is over"):
        pipeline.receive_view(site, kept(old))
    pipeline.receive_token(site, "r1", LATER, False)
    assert site.robots["r1"].alive, "the first agent still is there"


def test_a_robot_that_comes_back_is_found_on_its_old_keyframes():
    (old,) = messages(np.eye(4))
    (back,) = messages(turned(3), epoch=LATER)
    site = site_of(old)
    work_off_all(site)
    pipeline.receive_token(site, "r1", EPOCH, False)
    assert not site.robots["r1"].alive
    pipeline.receive_token(site, "r1", LATER, True)
    pipeline.receive_view(site, kept(back))
    work_off_all(site)
    attached = site.attached(back.name)
    assert attached is not None and attached.keyframe == old.name


def test_an_older_view_that_comes_late_is_kept_but_is_not_where_the_robot_is():
    first, second = messages(np.eye(4), turned(2))
    site = site_of(second)
    pipeline.receive_view(site, kept(first))
    assert site.robots["r1"].newest == second.name
    assert first.name in site.views


def test_another_calibration_and_a_clock_that_goes_back_are_told():
    first, second = messages(np.eye(4), turned(2))
    K = second.camera.K.copy()
    K[0, 0] += 5.0
    camera = second.camera.model_copy(update={"K": K})
    site = site_of(first)
    changed = second.model_copy(
        update={"camera": camera, "stamp_ns": first.stamp_ns - 7200 * 10**9}
    )
    pipeline.receive_view(site, kept(changed))
    assert any("another calibration" in event for event in site.events)
    assert any("went back by 7200.0 s" in event for event in site.events)


def selection(*views: ViewName, session: str = "a" * 12) -> Selection:
    i, j = (views[0].robot, views[1].robot) if len(views) == 2 else (None, None)
    at_i, at_j = views if len(views) == 2 else (None, None)
    return Selection(operator="op", session=session, i=i, j=j, view_i=at_i, view_j=at_j)


def test_selected_views_are_kept_as_long_as_they_are_selected():
    T_true = turned(15)
    both, _ = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    missing = pipeline.receive_selection(site, selection(named(0, "r1"), named(9, "r2")), 0.0)
    assert missing == [named(9, "r2")]
    assert site.pinned() == (named(0, "r1"),)
    assert named(0, "r1") in site.held()
    pipeline.receive_selection(site, selection(), 1.0)
    assert site.pinned() == ()


def test_a_client_that_is_gone_does_not_hold_views_for_ever():
    T_true = turned(15)
    both, _ = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    pipeline.receive_selection(site, selection(named(0, "r1"), named(0, "r2")), 0.0)
    late = PINNED_S + 1.0
    pipeline.receive_selection(site, selection(session="b" * 12), late)
    assert site.pinned() == ()


def test_a_click_in_a_view_that_was_overtaken_counts_once_that_view_is_placed():
    """r1 walked on before its second view was followed; the click in that view still joins."""
    T_true = turned(15)
    rng = np.random.default_rng(4)
    (first, other), points = scene_with_points_to_click(rng, T_true)
    site = site_of(first, other, skip=frozenset({("r1", "r2")}))
    overtaken = first.model_copy(update={"name": named(1, "r1")})
    site.views.keep(kept(overtaken))
    assert site.attached(overtaken.name) is None
    for n, point in enumerate(points, 1):
        (outcome,) = pipeline.receive_update(site, click(n, point, T_true, overtaken.name))
        assert outcome.accepted, outcome.reason
    newest = site.robots["r1"].track.newest
    work_off_all(site)
    assert site.attached(overtaken.name) is not None
    assert site.robots["r1"].track.newest == newest, "the past does not move the robot"
    T = site.relative(named(0, "r1"), named(0, "r2"))
    assert T is not None and np.linalg.norm(T[:3, 3] - T_true[:3, 3]) < 0.2


def test_a_past_view_is_hung_by_a_worker_where_the_robot_had_moved():
    first, second, third = messages(np.eye(4), turned(3), turned(6))
    site = site_of(first, third)
    work_off_all(site)
    before = site.robots["r1"].track.newest
    pipeline.receive_fetched(site, kept(second))
    assert pipeline.next_job(site, 0.0) is None, "nobody looks at it"
    pipeline.receive_selection(site, selection(second.name, named(0, "r2")), 0.0)
    job = pipeline.next_job(site, 0.0)
    assert job is not None and job.j.name == second.name
    pipeline.take_result(site, Done(job, run_job(job)), 0.0)
    assert site.attached(second.name) is not None
    assert site.robots["r1"].track.newest == before


def test_a_still_robot_is_placed_at_once_after_a_restart():
    (first,) = messages(np.eye(4))
    site = empty_site()
    restore(site, [kept(first)])
    pipeline.receive_token(site, "r1", EPOCH, True)
    again = first.model_copy(update={"name": named(7, "r1")})
    pipeline.receive_view(site, kept(again))
    assert site.attached(again.name) is not None
    assert pipeline.next_job(site, 0.0) is None


def told(site: Site, now_s: float):
    """The state of r2 as it is published at a time."""
    while site.dirty:  # once more where an anchor was chosen
        pipeline.solve(site, 0.0)
    stamp = builders.Stamp("0" * 12, now_s, int(1e9 * now_s))
    for robot in site.robots.values():
        found = builders.robot_pose(site, robot, SETTINGS, stamp)
        if robot.published is None and found is not None:
            robot.publish(*found)
    state = builders.fleet_state(site, SETTINGS, stamp, 1)
    return next(robot for robot in state.robots if robot.robot == "r2")


@pytest.mark.parametrize("offset_h", (-3, 0, 3))
def test_poses_age_by_the_servers_clock_whatever_the_robots_clocks_say(offset_h):
    T_true = turned(15)
    both, _ = scene_with_points_to_click(np.random.default_rng(4), T_true)
    offset_ns = offset_h * 3600 * 10**9
    site = site_of(*(one.model_copy(update={"stamp_ns": 10**18 + offset_ns}) for one in both))
    work_off_all(site)
    fresh, stale = told(site, 1.0), told(site, 60.0)
    assert fresh.pose.located and fresh.why_not == "" and fresh.pose.age_s == 1.0
    assert fresh.pose.valid_until_ns == 10**18 + offset_ns + int(1e9 * SETTINGS.fresh_s)
    assert not stale.pose.located and "60 s old" in stale.why_not and stale.pose.age_s == 60.0
    sigmas = [position_sigma(s.pose.T_fleet_robot, s.pose.covariance) for s in (fresh, stale)]
    older = told(site, 120.0).pose
    sigmas.append(position_sigma(older.T_fleet_robot, older.covariance))
    assert sigmas[1] > sigmas[0] + 0.1 * site.depth_m  # it may be anywhere by now
    assert sigmas[2] == pytest.approx(2 * sigmas[1], rel=0.01)


def test_a_robot_that_is_gone_is_not_located_any_more():
    T_true = turned(15)
    both, _ = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    work_off_all(site)
    assert told(site, 1.0).pose.located
    pipeline.receive_token(site, "r2", EPOCH, False)
    gone = told(site, 2.0)
    assert not gone.pose.located and gone.pose.age_s == 2.0 and "token is gone" in gone.why_not


def test_clicks_have_a_worker_of_their_own_and_a_flood_of_them_takes_none_from_the_robots():
    T_true = turned(15)
    both, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    for n, point in enumerate(points, 1):
        pipeline.receive_update(site, click(n, point, T_true))
    for seq in range(1, 4):
        site.pair("r1", "r2")._turn_to(PairStatus(due="clicks"))
        site.robots["r1"].waiting, site.robots["r1"].tracking = named(seq, "r1"), None
        site.views.keep(kept(both[0].model_copy(update={"name": named(seq, "r1")})))
        urgent, other = pipeline.urgent_job(site), pipeline.next_job(site, 0.0)
        assert urgent is not None and (urgent.kind, urgent.urgent) == ("clicks", True)
        assert other is not None and (other.kind, other.urgent) == ("track", False)
    site.pair("r1", "r2")._turn_to(PairStatus(due="clicks"))
    left = pipeline.next_job(site, 0.0)
    assert left is not None and left.kind == "clicks"  # where robots wait for nothing


def test_clicks_do_not_wait_for_features_which_may_not_take_back_what_they_say():
    T_true = turned(15)
    both, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    pipeline.solve(site, 0.0)
    while compare_some(site, 0.0):
        pass
    features = pipeline.next_job(site, 0.0)
    assert features is not None and features.kind == "pair"
    for n, point in enumerate(points, 1):
        pipeline.receive_update(site, click(n, point, T_true))
    clicks = pipeline.urgent_job(site)
    assert clicks is not None and clicks.kind == "clicks"
    assert pipeline.take_result(site, Done(clicks, run_job(clicks)), 0.0)
    told = site.pair("r1", "r2").last
    nothing = PairResult(None, None, "rejected", ("features say nothing",))
    assert not pipeline.take_result(site, Done(features, nothing), 0.1), "it is not to be told"
    assert site.pair("r1", "r2").last is told
    again = pipeline.urgent_job(site)
    assert isinstance(again, ClickJob) and again.known is nothing


def test_clicks_that_are_erased_while_features_are_asked_beside_them_leave_nothing():
    T_true = turned(15)
    both, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    for n, point in enumerate(points, 1):
        pipeline.receive_update(site, click(n, point, T_true))
    quick = pipeline.urgent_job(site)
    assert isinstance(quick, ClickJob)
    record = site.pair("r1", "r2")
    record.stop(PairResult(None, None, "rejected", ()), quick.views, 0.0, "clicks")
    record.search_later(0.0)
    search = pipeline.next_job(site, 0.0)
    assert isinstance(search, ClickJob)
    clear = click(4, points[0], T_true).model_copy(
        update={"action": "clear", "base_revision": 3, "view_i": None, "view_j": None}
    )
    (cleared,) = pipeline.receive_update(site, clear)
    assert cleared.accepted, cleared.reason
    assert pipeline.urgent_job(site) is None
    pipeline.take_result(site, Done(search, run_job(search)), 1.0)
    assert pipeline.urgent_job(site) is None
    assert not site.edges and not record.heard


def test_features_are_asked_beside_clicks_when_no_more_come():
    T_true = turned(15)
    both, points = scene_with_points_to_click(np.random.default_rng(4), T_true)
    site = site_of(*both)
    pipeline.receive_update(site, click(1, points[0], T_true))
    clicks = pipeline.urgent_job(site)
    assert clicks is not None and not clicks.features
    open_ = PairResult(None, None, "rejected", ("one point is too few",))
    pipeline.take_result(site, Done(clicks, open_), 5.0)
    assert pipeline.next_job(site, 5.0) is None
    search = pipeline.next_job(site, 5.0 + pipeline.QUIET_S)
    assert search is not None and search.kind == "clicks" and search.features


def test_a_robot_that_goes_before_its_first_view_after_a_restart_leaves_its_keyframes():
    (first, other), _ = scene_with_points_to_click(np.random.default_rng(4), turned(15))
    before = site_of(first, other)
    work_off_all(before)
    graph = graph_of(before)
    assert graph.edges, "the two robots are linked"
    site = empty_site()
    restore(site, [kept(first), kept(other)], graph.edges.values(), graph.gauge)
    for alive in (True, False):
        pipeline.receive_token(site, "r1", EPOCH, alive)
    pipeline.solve(site, 0.0)
    assert site.solution is not None and site.joined(first.name, other.name)
