"""What robots are told of what the server has of them."""

import time

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.app.acknowledgements import Acknowledgements
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.messages.builders import Stamp
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.drops import Drops
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Heard
from tests.pose_server.scene import EPOCH
from tests.pose_server.test_flows import kept, site_of, work_off
from tests.pose_server.test_lives import messages

KEYS = Keys("demo")


@pytest.fixture
def server():
    """A site, what is told of it under which key, and what tells."""
    site, told, drops = site_of(), [], Drops()
    put = lambda key, message: told.append((key, message))  # noqa: E731
    return site, told, Acknowledgements(site, KEYS, "5" * 12, put, drops)


def test_a_robot_hears_of_its_newest_view_and_how_long_it_lay_here(server):
    site, told, acknowledgements = server
    pipeline.receive_token(site, "r1", EPOCH, True)
    acknowledgements.tell_all()
    view = kept(messages(np.eye(4))[0], time.monotonic())
    pipeline.receive_view(site, view)
    acknowledgements.tell("r1", time.monotonic() - 0.5)
    (key, first), (_, then) = told
    assert key == "fleet/demo/heard/r1" and isinstance(first, Heard)
    assert (first.epoch, first.seq, first.n) == (None, None, 1)
    assert (then.epoch, then.seq, then.n) == (EPOCH, view.name.seq, 2)
    assert 0.5 <= then.waited_s < 1.0 and "fleet.view.v2" in then.reads


def test_only_robots_that_are_there_are_told(server):
    site, told, acknowledgements = server
    acknowledgements.tell("r9")
    pipeline.receive_token(site, "r1", EPOCH, True)
    pipeline.receive_view(site, kept(messages(np.eye(4))[0], time.monotonic()))
    pipeline.receive_token(site, "r1", EPOCH, False)
    acknowledgements.tell_all()
    assert told == []


def test_refused_views_are_told_to_their_robot_and_to_who_asks_why(server):
    site, told, acknowledgements = server
    pipeline.receive_token(site, "r1", EPOCH, True)
    reason = "view r1/a/1 has 0 points with depth, need 10"
    for _ in range(2):
        acknowledgements.drops.note(KEYS.cloud("r1"), reason)
        pipeline.refuse_view(site, "r1", CodecError(reason))
    pipeline.refuse_view(site, "r9", CodecError(reason))
    acknowledgements.tell("r1")
    assert told[0][1].drops == acknowledgements.drops.of("robot/r1") and told[0][1].drops
    answer = builders.why_not(site, "r1", ServerSettings(), 0.0)
    assert answer.why_not == f"alive, but its views are refused, 2 so far: {reason}"
    pipeline.receive_view(site, kept(messages(np.eye(4))[0], 5.0))
    assert "refused" not in builders.why_not(site, "r1", ServerSettings(), 5.0).why_not


def test_newer_views_that_are_refused_are_why_the_newest_one_is_old(server):
    site, _, _ = server
    pipeline.receive_token(site, "r1", EPOCH, True)
    pipeline.receive_view(site, kept(messages(np.eye(4))[0]))
    work_off(site)
    robot = site.robots["r1"]
    found = builders.robot_pose(site, robot, ServerSettings(), Stamp("5" * 12, 0.0, 0), ())
    assert found is not None
    robot.publish(*found)
    assert "is 60 s old" in builders.why_not_located(site, robot, ServerSettings(), 60.0)
    pipeline.refuse_view(site, "r1", CodecError("it has no points"))
    why = builders.why_not_located(site, robot, ServerSettings(), 60.0)
    assert why == "its newest view is 60 s old: 1 since were refused: it has no points"
