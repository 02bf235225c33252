"""What a pair's images say of clicks is heard in the graph, in the poses, and by the operator."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.geometry.se3 import inverse, transform
from fleetpose.pose_server.messages.builders import Stamp, fleet_state, robot_pose
from fleetpose.pose_server.pose_graph.types import Edge
from fleetpose.pose_server.questions.facts import questions
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import encoding_of, pack
from fleetpose.protocol.messages import OperatorUpdate, View
from tests.pose_server.scene import K, descriptors, turned, view, walls
from tests.pose_server.test_asking import SESSION, Forgetful

T_TRUE = turned(30)
SETTINGS = ServerSettings.model_validate({})
STAMP = Stamp(SESSION, 0.0, 0)
CORNERS = [(0.5, -2.5), (2.5, -1.0), (1.0, 2.5), (2.4, 2.2), (-3.0, -2.0), (-1.0, 2.5), (-2.0, 0.5)]
STEP = np.array([2.0, 0.0, 0.4])  # one window further along the wall to the right


class Two:
    """A site of two robots whose pair is left to the operator, and the operator."""

    def __init__(self, blank: bool = False) -> None:
        rng = np.random.default_rng(4)
        points, looks = walls(rng, 3000), descriptors(rng, 3000)
        self.site = Site(
            correspondences=CorrespondenceStore(Forgetful()),
            skip=frozenset({("r1", "r2")}),
            anchor="r1",
        )
        for name, T in (("r1", np.eye(4)), ("r2", inverse(T_TRUE))):
            message = view(rng, name, points, looks, T)
            if blank:  # the images look like nothing in each other
                few = view(rng, name, points[:60], descriptors(rng, 60), T).salient
                message = message.model_copy(update={"salient": few})
            pipeline.receive_token(self.site, name, message.name.epoch, True)
            pipeline.receive_view(self.site, open_view(pack(message), encoding_of(View), 0.0))
        pipeline.solve(self.site, 0.0)
        self.points = np.array(
            [points[np.abs(points[:, :2] - xy).sum(axis=1).argmin()] for xy in CORNERS]
        )
        self.n = 0

    def click(self, k: int, off: np.ndarray | None = None) -> None:
        """Clicks a corner in r1, and in r2 what it is taken for."""
        self.n += 1
        point = self.points[k]
        meant = point if off is None else point + off
        at_j = transform(inverse(T_TRUE), meant[None])[0]
        update = OperatorUpdate(
            operator="op",
            session=SESSION,
            n=self.n,
            action="add",
            i="r1",
            j="r2",
            base_revision=0,
            view_i=self.site.robots["r1"].newest,
            view_j=self.site.robots["r2"].newest,
            pixel_i=(K @ point)[:2] / point[2],
            pixel_j=(K @ at_j)[:2] / at_j[2],
        )
        (outcome,) = pipeline.receive_update(self.site, update)
        assert outcome.accepted, outcome.reason

    def work(self) -> None:
        while (
            job := pipeline.urgent_job(self.site) or pipeline.next_job(self.site, pipeline.QUIET_S)
        ) is not None:
            pipeline.take_result(self.site, Done(job, run_job(job)), 0.0)
        pipeline.solve(self.site, 0.0)
        pipeline.judge_correspondences(self.site)

    def located(self) -> bool:
        found = robot_pose(self.site, self.site.robots["r2"], SETTINGS, STAMP)
        return found is not None and found[0].located

    def statuses(self) -> list[str]:
        return [kept.item.status for kept in self.site.correspondences.of("r1", "r2")]


def state(site):
    for robot in site.robots.values():
        if (found := robot_pose(site, robot, SETTINGS, STAMP)) is not None:
            robot.publish(*found)
    return fleet_state(site, SETTINGS, STAMP, 1)


def test_clicks_join_nothing_before_the_images_were_asked():
    two = Two()
    for k in range(3):
        two.click(k)
    pipeline.solve(two.site, 0.0)
    pipeline.judge_correspondences(two.site)
    assert not two.located() and two.statuses() == ["unused"] * 3
    two.work()
    assert two.located() and two.statuses() == ["accepted"] * 3


@pytest.mark.parametrize("count", [3, 4])
def test_wrong_clicks_that_fit_each_other_locate_nobody_and_right_ones_added_later_win(count):
    two = Two()
    for k in range(count):
        two.click(k, STEP)
    two.work()
    assert not two.located() and two.statuses() == ["outlier"] * count
    now = state(two.site)
    (why,) = (robot.why_not for robot in now.robots if robot.robot == "r2")
    (answer,) = now.answered
    for text in (why, answer.text, "\n".join(now.events), now.questions[0].reason):
        assert "fit each other, but" in text
    assert answer.joined == ()
    for k in range(4, 7):
        two.click(k)
        two.work()
    assert two.located()
    assert two.statuses()[count:] == ["accepted"] * 3
    assert two.statuses()[:count] == ["outlier"] * count
    T = two.site.relative(two.site.robots["r1"].newest, two.site.robots["r2"].newest)
    assert np.linalg.norm(T[:3, 3] - T_TRUE[:3, 3]) < 0.2
    assert "fit each other, but" not in state(two.site).answered[-1].text


def test_where_images_can_say_nothing_clicks_join_but_locate_nobody_and_that_is_said():
    two = Two(blank=True)
    for k in range(2, 7):
        two.click(k)
    two.work()
    assert two.statuses() == ["accepted"] * 5 and not two.located()
    (why,) = (robot.why_not for robot in state(two.site).robots if robot.robot == "r2")
    assert "gravely wrong with a probability of 10" in why
    assert "neither confirm nor contradict" in why


def test_clicks_that_are_erased_leave_nothing_behind():
    two = Two()
    for k in range(3):
        two.click(k, STEP)
    two.work()
    assert two.site.pair("r1", "r2").told
    for kept in two.site.correspondences.of("r1", "r2"):
        two.n += 1
        update = OperatorUpdate(
            operator="op",
            session=SESSION,
            n=two.n,
            action="erase",
            i="r1",
            j="r2",
            correspondence=kept.item.id,
            base_revision=kept.item.revision,
        )
        pipeline.receive_update(two.site, update)
    two.work()
    assert not two.site.pair("r1", "r2").told and not two.site.pair("r1", "r2").heard


def test_a_pair_that_fits_two_ways_joins_nothing_and_the_question_asks_for_what_breaks_the_tie():
    two = Two()
    twin = T_TRUE @ np.diag([-1.0, 1.0, -1.0, 1.0])
    views = [two.site.robots[name].newest for name in ("r1", "r2")]
    for k in range(3):
        two.click(k)
    job = pipeline.urgent_job(two.site)
    assert job is not None
    reasons = ("another pose explains the images as well",)
    result = PairResult(T_TRUE, np.eye(6) * 1e-4, "ambiguous", reasons, rivals=(twin,))
    pipeline.take_result(two.site, Done(job, result), 0.0)
    pipeline.solve(two.site, 0.0)
    assert not two.site.joined(*views)
    (question,) = questions(two.site)
    assert "r1-r2 fits 2 ways" in question.reason and "180 deg apart" in question.reason
    assert "is there something that exists only once?" in question.reason


def test_where_the_rest_of_the_fleet_contradicts_points_that_fit_their_pair_that_is_said():
    two = Two(blank=True)
    for k in range(2, 7):
        two.click(k)
    two.work()
    elsewhere = T_TRUE.copy()
    elsewhere[0, 3] += 3.0
    a, b = (two.site.robots[name].newest for name in ("r1", "r2"))
    two.site.link(Edge(a, b, elsewhere, 1e-6 * np.eye(6), "verified"))
    two.work()
    assert two.statuses() == ["outlier"] * 5
    assert "the rest of the fleet contradicts them" in two.site.pair("r1", "r2").contradicted
    assert sum("the rest of the fleet" in event for event in two.site.events) == 1
