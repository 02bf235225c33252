"""What is told of pairs and poses: the last try, not the best; nothing that is over as if it
were now; and never nothing for long.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app import publisher, queries
from fleetpose.pose_server.app.publisher import LONGEST_PAUSE_S, FleetPublisher, pause_s
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.frames import position_sigma
from fleetpose.pose_server.geometry.se3 import hat
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.messages.error_matrix import pair_cells
from fleetpose.pose_server.messages.relative_pose import p_grave_of, relative_pose
from fleetpose.pose_server.pose_graph.types import EdgeJudgement
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import Done, PairJob
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RelativePose, RobotPose, ViewName, WhyNot
from tests.pose_server.scene import EPOCH, turned
from tests.pose_server.test_flows import (
    Forgetful,
    named,
    scene_with_points_to_click,
    site_of,
    work_off,
)

LATER = "1" * 12
SETTINGS = ServerSettings()
JOB_VIEWS = (named(0, "r1"), named(0, "r2"))


def fleet_of_two() -> Site:
    """Two robots that see the same, aligned and solved at 0 s."""
    both, _ = scene_with_points_to_click(np.random.default_rng(4), turned(15))
    site = site_of(*both)
    work_off(site)
    while site.dirty:
        pipeline.solve(site, 0.0)
    return site


def aligned(site: Site, result: PairResult | None, now_s: float, error: str = "") -> None:
    """The two robots were aligned once more."""
    record = site.pair("r1", "r2")
    i, j = (site.encoded(view) for view in JOB_VIEWS)
    job = PairJob(i, j)
    record.start()
    pipeline.take_result(site, Done(job, result, error), now_s)


def cell_of(site: Site, now_s: float):
    (cell,) = pair_cells(site, now_s, {})
    return cell


# ---- the last, not the best ----------------------------------------------------------------------

results = st.builds(
    lambda verdict, rmse_m, inliers, p_grave, rivals: PairResult(
        np.eye(4),
        np.eye(6) * 1e-6,
        verdict,
        ("because",),
        inliers=inliers,
        overlap=0.5,
        rmse_m=rmse_m,
        p_grave=p_grave,
        rivals=(np.eye(4),) * rivals,
    ),
    st.sampled_from(("verified", "plausible", "ambiguous", "rejected")),
    st.floats(0.001, 9.0),
    st.integers(0, 500),
    st.floats(0.0, 1.0),
    st.integers(0, 3),
)


@pytest.fixture(scope="module")
def two() -> Site:
    return fleet_of_two()


@given(tried=st.lists(st.tuples(results | st.none(), st.floats(0.1, 30.0)), min_size=1, max_size=6))
def test_whatever_was_tried_before_the_last_try_alone_is_shown_with_its_age(two, tried):
    now_s = 0.0
    for result, pause in tried:
        now_s += pause
        aligned(two, result, now_s, "no worker")
    cell, last = cell_of(two, now_s + 7.5), tried[-1][0]
    (error,) = builders.pair_errors(two, two.robots["r1"])
    assert cell.state == "tried" and cell.age_s == 7.0
    assert (error.other, error.rmse_m, error.verdict) == ("r2", cell.rmse_m, cell.verdict)
    if last is None:
        assert (cell.verdict, cell.rmse_m, cell.p_grave, cell.rivals) == ("rejected", None, None, 0)
        return
    assert (cell.verdict, cell.p_grave) == (last.verdict, last.p_grave)
    assert cell.rivals == len(last.rivals)
    shown = None if last.verdict == "rejected" else last.rmse_m
    assert cell.rmse_m == shown and (cell.overlap == 0.0) == (shown is None)


def test_the_graph_goes_on_with_the_best_older_edge_when_the_last_try_fails():
    site = fleet_of_two()
    before = site.relative(*JOB_VIEWS)
    aligned(site, PairResult(None, None, "rejected", ("3 matches, need 6",)), 20.0)
    work_off(site)
    assert np.allclose(site.relative(*JOB_VIEWS), before)
    assert cell_of(site, 20.0).verdict == "rejected"


def test_a_failed_alignment_is_told_as_rejected_with_the_reason():
    site = fleet_of_two()
    aligned(site, None, 5.0, "its worker died")
    told = builders.alignment(*JOB_VIEWS, site.pair("r1", "r2").last, STAMP(5.0), 1)
    assert told.verdict == "rejected" and told.T_i_j is None
    assert told.reasons == ("the alignment failed: its worker died",)


# ---- one robot seen from another -----------------------------------------------------------------


def STAMP(now_s: float) -> builders.Stamp:
    return builders.Stamp("0" * 12, now_s, int(1e9 * now_s))


def published(site: Site, now_s: float) -> Site:
    for robot in site.robots.values():
        if (found := builders.robot_pose(site, robot, SETTINGS, STAMP(now_s))) is not None:
            robot.publish(*found)
    return site


def sigma_m(told: RelativePose | RobotPose) -> float:
    T = told.T_a_b if isinstance(told, RelativePose) else told.T_fleet_robot
    return position_sigma(T, told.covariance)


def test_a_relative_pose_says_that_both_are_located_and_by_what():
    site = published(fleet_of_two(), 1.0)
    key = next(key for key in site.edges if key[2] == "pair")
    site.edges[key] = replace(site.edges[key], p_grave=0.07)
    told = relative_pose(site, "r1", "r2", SETTINGS, 1.0)
    assert isinstance(told, RelativePose)
    assert (told.located, told.why_not, told.age_s) == (True, "", 1.0)
    assert told.verdict == site.solution.nodes[named(0, "r2")].verdict
    assert told.p_grave == pytest.approx(0.07)


@pytest.mark.parametrize(("sigma", "located"), [(0.015, True), (0.035, False), (0.06, False)])
def test_who_is_known_so_badly_that_noise_alone_may_be_grave_is_not_located(sigma, located):
    site = fleet_of_two()
    views = {name: robot.track.newest.keyframe for name, robot in site.robots.items()}
    node = site.solution.nodes[views["r2"]]
    variances = np.repeat((1e-8, (sigma * site.depth_m) ** 2), 3)
    shift = np.eye(6)
    shift[3:, :3] = -hat(node.T_root_camera[:3, 3])
    covariance = np.linalg.inv(shift) @ np.diag(variances) @ np.linalg.inv(shift).T
    site.solution.nodes[views["r2"]] = replace(node, covariance=covariance)
    pose = published(site, 1.0).robots["r2"].published
    assert pose.located is located
    assert located or "its position is known to" in pose.why_not


@pytest.mark.parametrize("gone", ["r1", "r2"])
def test_a_robot_switched_off_half_a_minute_ago_is_nowhere_to_the_millimetre(gone):
    site = published(fleet_of_two(), 1.0)
    before = relative_pose(site, "r1", "r2", SETTINGS, 1.0)
    pipeline.receive_token(site, gone, EPOCH, False)
    told = relative_pose(site, "r1", "r2", SETTINGS, 30.0)
    assert not told.located and f"{gone}: its token is gone" in told.why_not
    assert sigma_m(told) > sigma_m(before) + 0.3 * site.depth_m
    assert told.age_s == 30.0 and np.allclose(told.T_a_b, before.T_a_b)


@given(age_s=st.floats(0.0, 600.0), more_s=st.floats(0.1, 600.0))
def test_what_is_known_of_a_silent_robot_only_gets_less_by_time(two, age_s, more_s):
    published(two, 0.0)
    sooner, later = (
        relative_pose(two, "r1", "r2", SETTINGS, at_s) for at_s in (age_s, age_s + more_s)
    )
    grown = np.linalg.eigvalsh(later.covariance - sooner.covariance)
    assert grown[0] > -1e-9 * max(grown[-1], 1.0)
    assert later.located == (age_s + more_s <= SETTINGS.fresh_s)


def test_who_cannot_be_told_of_is_an_error_with_the_reason():
    site = site_of()
    pipeline.receive_token(site, "r1", EPOCH, True)
    asked = {"from": "r1", "to": "r9"}
    assert "no robot 'r9' is known; known are: r1" in queries.relative(site, SETTINGS, asked).error
    pipeline.receive_token(site, "r9", EPOCH, True)
    assert "has no aligned view yet" in queries.relative(site, SETTINGS, asked).error
    assert "ask as" in queries.relative(site, SETTINGS, {}).error
    assert "ask as" in queries.why(site, SETTINGS, {}).error


@given(chances=st.lists(st.floats(0.0, 1.0), min_size=1, max_size=6))
def test_a_way_is_at_least_as_doubtful_as_each_link_and_no_more_than_all_together(chances):
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    way = tuple(ViewName(robot=f"r{k}", epoch=EPOCH, seq=0) for k in range(len(chances) + 1))
    edges = [
        pipeline.Edge(a, b, np.eye(4), np.eye(6), p_grave=p)
        for a, b, p in zip(way, way[1:], chances, strict=False)
    ]
    spare = replace(edges[0], a=edges[0].b, b=edges[0].a, p_grave=1.0)
    site.edges = {edge.key: edge for edge in (*edges, spare)}
    used = {key: EdgeJudgement(1.0, 0.0, False) for key in site.edges}

    class Solved:
        edges = used

    site.solution = Solved()
    found = p_grave_of(site, way)
    assert max(chances) - 1e-12 <= found <= min(sum(chances), 1.0) + 1e-12
    used[edges[0].key] = EdgeJudgement(0.0, 99.0, True)  # set aside: it vouches for nothing
    assert p_grave_of(site, way) == 1.0
    del site.edges[spare.key]
    assert p_grave_of(site, way) is None


# ---- robots hear what operators hear -------------------------------------------------------------


@pytest.mark.parametrize("now_s", [1.0, 60.0])
def test_a_robot_is_told_the_operators_words(now_s):
    site = published(fleet_of_two(), now_s)
    state = builders.fleet_state(site, SETTINGS, STAMP(now_s), 1)
    for robot in state.robots:
        answer = queries._answer(builders.why_not(site, robot.robot, SETTINGS, now_s))
        told = unpack(WhyNot, answer.payload, answer.encoding)
        assert told.why_not == robot.why_not and told.located == (not robot.why_not)
        assert robot.pose.why_not == robot.why_not
        assert bool(robot.why_not) == (now_s > SETTINGS.fresh_s)


def teller_of(site: Site, monkeypatch) -> tuple[FleetPublisher, list[RobotPose], list[float]]:
    """A teller whose clock is the test's."""
    heard: list[RobotPose] = []
    clock = [1.0]
    monkeypatch.setattr(publisher.time, "monotonic", lambda: clock[0])

    def put(_: str, message: object) -> None:
        if isinstance(message, RobotPose):
            heard.append(message)

    return FleetPublisher(site, Keys(), SETTINGS, "0" * 12, put), heard, clock


def test_who_hears_poses_alone_hears_that_a_robot_is_gone(monkeypatch):
    site = fleet_of_two()
    teller, heard, clock = teller_of(site, monkeypatch)
    teller.moved()
    teller.state()
    assert [(pose.robot, pose.located) for pose in heard] == [("r1", True), ("r2", True)]
    clock[0] = 2.0
    pipeline.receive_token(site, "r2", EPOCH, False)
    teller.moved()
    teller.state()
    teller.state()
    last = heard[-1]
    assert len(heard) == 3 and (last.robot, last.located) == ("r2", False)
    assert "its token is gone" in last.why_not and last.n > heard[1].n
    clock[0] = 60.0
    teller.state()
    assert len(heard) == 4 and heard[-1].robot == "r1" and not heard[-1].located
    assert sigma_m(heard[-1]) > 0.5 * site.depth_m and heard[-1].valid_for_s == 0.0


def test_a_robot_started_anew_is_not_where_its_last_life_was(monkeypatch):
    site = fleet_of_two()
    teller, heard, _ = teller_of(site, monkeypatch)
    teller.moved()
    pipeline.receive_token(site, "r2", LATER, True)
    teller.state()
    assert (heard[-1].robot, heard[-1].located) == ("r2", False)
    assert "started anew" in heard[-1].why_not
    newest = site.views[named(0, "r2")]
    again = replace(newest, name=ViewName(robot="r2", epoch=LATER, seq=0), received_s=1.0)
    pipeline.receive_view(site, again)
    work_off(site)
    teller.moved()
    assert (heard[-1].robot, heard[-1].located) == ("r2", True)


# ---- never nothing for long ----------------------------------------------------------------------


@given(took_s=st.floats(0.0, 1e6))
def test_the_state_costs_little_but_is_never_silent_for_more_than_a_second(took_s):
    period_s = took_s + pause_s(took_s)
    assert period_s <= max(LONGEST_PAUSE_S, took_s) and pause_s(took_s) >= 0.0
    if took_s < 0.04:  # then a twentieth of the time is what it may take
        assert took_s <= 0.05 * period_s * (1 + 1e-9)


@pytest.mark.parametrize("held_up_s", [0.4, 2.0, 60.0])
def test_a_thread_that_was_held_up_tells_the_next_state_within_a_second(held_up_s, monkeypatch):
    site = Site(correspondences=CorrespondenceStore(Forgetful()))
    teller, _, clock = teller_of(site, monkeypatch)

    def slow(*_: object) -> None:
        clock[0] += held_up_s

    teller.put = slow
    assert teller.state() <= LONGEST_PAUSE_S
