"""What became of questions: looks in vain, clicks and what they did, points to confirm."""

from dataclasses import replace

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.correspondences.records import BookState, Change
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.messages.builders import Stamp, fleet_state
from fleetpose.pose_server.questions.facts import questions
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.state.views import open_view
from fleetpose.pose_server.workers.jobs import Done, PairJob
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.messages import FleetState, OperatorUpdate, Selection, View
from tests.pose_server.scene import EPOCH, K, descriptors, turned, view, walls

T_TRUE = turned(15)
CORNERS = ((-2.0, -2.0), (2.0, -1.5), (0.0, 2.0))
SESSION = "a" * 12


class Forgetful:
    """A recorder that holds nothing."""

    def load(self) -> BookState:
        return BookState()

    def record(self, change: Change) -> None:
        pass


@pytest.fixture
def scene():
    """A site of two robots whose pair is left to the operator, and points that both see."""
    rng = np.random.default_rng(4)
    points, looks = walls(rng, 3000), descriptors(rng, 3000)
    messages = (
        view(rng, "r1", points, looks, np.eye(4)),
        view(rng, "r2", points, looks, inverse(T_TRUE)),
    )
    site = Site(
        correspondences=CorrespondenceStore(Forgetful()),
        skip=frozenset({("r1", "r2")}),
        anchor="r1",
    )
    for message in messages:
        pipeline.receive_token(site, message.name.robot, message.name.epoch, True)
        kept = open_view(pack(message), encoding_of(View), 0.0)
        pipeline.receive_view(site, kept)
    pipeline.solve(site, 0.0)
    nearest = [points[np.argmin(np.abs(points[:, :2] - xy).sum(axis=1))] for xy in CORNERS]
    return site, nearest


def look(site, pair, now_s):
    views = [site.robots[name].newest for name in pair] if pair else [None, None]
    names = pair or (None, None)
    selection = Selection(
        operator="op", session=SESSION, i=names[0], j=names[1], view_i=views[0], view_j=views[1]
    )
    pipeline.receive_selection(site, selection, now_s)


def click(site, n, point):
    at_j = inverse(T_TRUE)[:3, :3] @ point + inverse(T_TRUE)[:3, 3]
    update = OperatorUpdate(
        operator="op",
        session=SESSION,
        n=n,
        action="add",
        i="r1",
        j="r2",
        base_revision=0,
        view_i=site.robots["r1"].newest,
        view_j=site.robots["r2"].newest,
        pixel_i=(K @ point)[:2] / point[2],
        pixel_j=(K @ at_j)[:2] / at_j[2],
    )
    (outcome,) = pipeline.receive_update(site, update)
    assert outcome.accepted, outcome.reason


def work(site):
    while (job := pipeline.next_job(site, pipeline.QUIET_S)) is not None:
        pipeline.take_result(site, Done(job, run_job(job)), 0.0)
    pipeline.solve(site, 0.0)


def test_looking_without_a_click_makes_the_question_worth_less(scene):
    site, _ = scene
    (before,) = questions(site)
    look(site, ("r1", "r2"), 0.0)
    look(site, None, 10.0)
    (after,) = questions(site)
    assert after.gain < 0.2 * before.gain
    assert "Looked at once without a click" in after.reason


def test_a_glance_or_a_look_that_goes_on_or_that_led_to_a_click_is_not_in_vain(scene):
    site, points = scene
    look(site, ("r1", "r2"), 0.0)
    look(site, None, 1.0)
    for second in range(10, 60, 10):
        look(site, ("r1", "r2"), float(second))
    assert not site.feedback.in_vain
    click(site, 1, points[0])
    look(site, None, 100.0)
    assert not site.feedback.in_vain


def test_what_clicks_did_is_told_beside_what_was_expected(scene):
    site, points = scene
    (question,) = questions(site)
    for n, point in enumerate(points, 1):
        click(site, n, point)
    work(site)
    (answer,) = site.feedback.answers
    assert (answer.i, answer.j, answer.clicks, answer.joined) == ("r1", "r2", 3, ("r2",))
    assert np.isclose(answer.predicted, 3 * question.gain)
    assert answer.realised > 0.1
    assert [event for event in site.events if event == answer.text]


def test_the_state_carries_answers_and_questions(scene):
    site, points = scene
    stamp = Stamp(EPOCH, 0.0, 0)
    settings = ServerSettings.model_validate({})
    asked = unpack(FleetState, pack(fleet_state(site, settings, stamp, 1)))
    assert [(question.i, question.j) for question in asked.questions] == [("r1", "r2")]
    click(site, 1, points[0])
    pipeline.solve(site, 0.0)
    told = unpack(FleetState, pack(fleet_state(site, settings, stamp, 2)))
    assert [answer.clicks for answer in told.answered] == [1]


def test_points_to_confirm_come_with_the_views_that_were_aligned(scene):
    site, _ = scene
    views = [site.encoded(site.robots[name].newest) for name in ("r1", "r2")]
    job = PairJob(*views, features=False)  # no start leads anywhere
    pipeline.take_result(site, Done(job, run_job(job)), 0.0)
    pipeline.solve(site, 0.0)
    record = site.pair("r1", "r2")
    assert record.last is not None and record.last.verdict == "rejected"
    (question,) = questions(site)
    assert (question.view_i, question.view_j) == record.last_views
    assert 0 < len(question.suggestions) <= 8
    for one in question.suggestions:
        assert np.isfinite((*one.pixel_i, *one.pixel_j)).all()


def test_questions_are_ranked_anew_only_when_something_changed(scene):
    site, points = scene
    questions(site)
    first = site.feedback.asked.questions
    questions(site)
    assert site.feedback.asked.questions is first
    click(site, 1, points[0])
    questions(site)
    assert site.feedback.asked.questions is not first


def test_what_looks_alike_is_suggested_for_a_pair_that_was_never_tried(scene):
    site, _ = scene
    assert site.pair("r1", "r2").last is None
    (question,) = questions(site)
    assert len(question.suggestions) > 2


def test_suggestions_are_about_the_newest_view_of_a_robot_that_stands_still(scene):
    site, _ = scene
    (before,) = questions(site)
    old = site.views[before.view_i]
    name = old.name.model_copy(update={"seq": old.name.seq + 5})
    pipeline.receive_view(site, replace(old, name=name))
    (after,) = questions(site)
    assert (after.view_i, after.view_j) == (name, before.view_j)
