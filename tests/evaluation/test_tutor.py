"""A learner's points: how far off they are, and what they did to a fleet."""

from collections import Counter

import numpy as np
import pytest

from fleetpose.evaluation.simulate.world.robots import rig_with
from fleetpose.evaluation.system.tutor.lesson import PERIOD_M, lesson_in, pairs_across
from fleetpose.evaluation.system.tutor.points import Clicked, likeness, offset_of, whole_steps
from fleetpose.evaluation.system.tutor.robots import robots_in, views_of
from fleetpose.evaluation.system.tutor.truths import (
    ExactTruth,
    FinalPoses,
    depth_in,
    truth_beside,
)
from fleetpose.hmi_client.cli.connection import Connection
from fleetpose.hmi_client.desk.desk import Desk
from fleetpose.hmi_client.tutor.lesson import Lesson
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.recording.file import Recorder, RecordingError
from fleetpose.protocol.transport import wait_until
from fleetpose.robot_agent.cameras.synthetic import mount

PLANTED_PX = (60.0, -12.0)
RIGHT, WRONG = (512, 300), (170, 378)  # in r3's image: on the poster, on the ground


@pytest.fixture(scope="module")
def lesson(tmp_path_factory):
    return lesson_in(tmp_path_factory.mktemp("lesson"))


@pytest.fixture(scope="module")
def truth(lesson):
    return ExactTruth.read(truth_beside(lesson))


def true_pixel(truth, pixel):
    """Where r4 sees what r3 sees at a pixel with whole coordinates: independent of the tutor."""
    K = rig_with(1.0).K_left
    T_world_i, T_world_j = (truth.T_world_robots[robot] @ mount() for robot in ("r3", "r4"))
    z = truth.depths["r3"][pixel[1], pixel[0]]
    in_i = np.append(z * np.linalg.solve(K, (*pixel, 1.0)), 1.0)
    in_j = K @ (np.linalg.solve(T_world_j, T_world_i @ in_i))[:3]
    return in_j[:2] / in_j[2]


def views(lesson):
    recording, _ = robots_in(lesson)
    return {kept.view.name.robot: kept for _, kept in views_of(recording)}


def offset(truth, lesson, pixel_i, pixel_j):
    seen = views(lesson)
    sides = (("r3", pixel_i), ("r4", pixel_j))
    i, j = (Clicked(seen[r].view, seen[r].jpeg, np.array(p, float)) for r, p in sides)
    return offset_of(truth, i, j)


def test_depth_between_pixels_of_a_plane_is_exact_and_an_edge_is_not_smeared():
    u, v = np.meshgrid(np.arange(8.0), np.arange(6.0))
    plane = 1 / (0.1 + 0.002 * u + 0.001 * v)
    assert depth_in(plane, np.array((3.4, 2.7))) == pytest.approx(1 / (0.1 + 0.0068 + 0.0027))
    plane[:, 4:] = 50.0
    assert depth_in(plane, np.array((3.4, 2.0))) == plane[2, 3]
    plane[2, 3] = np.nan
    assert depth_in(plane, np.array((3.4, 2.0))) is None
    assert depth_in(plane, np.array((-1.0, 2.0))) is None


def test_only_whole_steps_of_a_pattern_are_called_so():
    step = np.array((PERIOD_M, 0.0, 0.0))
    assert whole_steps(np.array((-2 * PERIOD_M, 0.1, -0.2)), step) == -2
    assert whole_steps(np.array((0.5 * PERIOD_M, 0.0, 0.0)), step) == 0
    assert whole_steps(np.array((PERIOD_M, 1.5, 0.0)), step) == 0


def test_places_that_look_alike_are_told_from_others():
    image = np.random.default_rng(0).integers(0, 255, (120, 200), np.uint8)
    image[40:81, 120:161] = image[40:81, 20:61]
    assert likeness(image, np.array((40.0, 60.0)), np.array((140.0, 60.0))) > 0.99
    assert likeness(image, np.array((40.0, 60.0)), np.array((90.0, 60.0))) < 0.5
    assert likeness(image, np.array((3.0, 60.0)), np.array((90.0, 60.0))) is None


def test_a_point_one_window_further_is_named_as_that(lesson, truth):
    at = np.array(RIGHT)
    right = true_pixel(truth, at)
    assert offset(truth, lesson, at, right).off_px < 0.01
    T_world_j = truth.T_world_robots["r4"] @ mount()
    K = rig_with(1.0).K_left
    z = truth.depths["r3"][at[1], at[0]]
    wall = truth.T_world_robots["r3"] @ mount() @ np.append(z * np.linalg.solve(K, (*at, 1)), 1)
    further = K @ np.linalg.solve(T_world_j, wall - (PERIOD_M, 0, 0, 0))[:3]
    off = offset(truth, lesson, at, further[:2] / further[2])
    assert off.steps == -1
    assert off.off_m == pytest.approx(PERIOD_M, abs=0.2)


def test_what_the_other_image_lacks_is_told(lesson, truth):
    assert offset(truth, lesson, (5.0, 200.0), (5.0, 200.0)).why in ("outside", "hidden")
    unknown = ExactTruth({"r3": truth.T_world_robots["r3"]}, truth.depths)
    assert offset(unknown, lesson, RIGHT, RIGHT).why == "no pose"
    assert offset(FinalPoses(), lesson, RIGHT, RIGHT).why == "no pose"


def test_the_lesson_is_kept_and_tells_the_robots_nothing_of_the_truth(lesson, truth):
    made = lesson.stat().st_mtime_ns
    assert lesson_in(lesson.parent) == lesson and lesson.stat().st_mtime_ns == made
    recording, robots = robots_in(lesson)
    keys = Keys(recording.site)
    assert robots == ("r1", "r2", "r3", "r4", "r5")
    said = {record.sample.key for record in recording}
    assert said == {key for r in robots for key in (keys.cloud(r), keys.image(r))}
    across = pairs_across(robots, ("r4", "r5"))
    assert len(across) == 6 and ("r4", "r5") not in across


def test_a_recording_without_views_is_refused(tmp_path):
    with Recorder(tmp_path / "empty.mcap", "demo"):
        pass
    with pytest.raises(RecordingError, match="has 0 robots with images"):
        robots_in(tmp_path / "empty.mcap")


def clicked(desk, pixel_i, pixel_j):
    """Clicks a point, and waits for what becomes of it."""
    before = len(desk.session.entries())
    desk.do("pick", side=0, pixel=pixel_i)
    desk.do("pick", side=1, pixel=pixel_j)

    def done():
        entries = desk.session.entries()
        return len(entries) > before and all(e.status != "pending" for e in entries)

    assert wait_until(done, 30.0)


def test_a_learner_is_told_how_far_a_planted_point_is_off_and_what_a_right_one_did(lesson, truth):
    right, at_wrong = true_pixel(truth, RIGHT), true_pixel(truth, WRONG)
    with Lesson(None, lesson.parent) as running:
        ready = running.prepare(lambda *_: None)
        where = Connection(ready.connect, ready.site, None, "learner")
        with where.client_of_server(patient=True) as client:
            desk = Desk(client.session)
            assert wait_until(lambda: _pieces(client.session) == [2, 3], 60.0)
            desk.do("select", a="r3", b="r4")
            assert wait_until(lambda: bool(desk.picture(0) and desk.picture(1)), 30.0)
            clicked(desk, WRONG, at_wrong + PLANTED_PX)
            clicked(desk, RIGHT, right)
            wait_until(lambda: _located(client.session) == len(ready.robots), 60.0)
            desk.close()
        report = running.finish()
    wrong, good = report["points"]
    assert wrong["off_px"] == pytest.approx(np.hypot(*PLANTED_PX), abs=1.0)
    assert np.allclose(wrong["fits"], at_wrong, atol=1.0)
    assert good["off_px"] < 1.0 and good["off_m"] < 0.05
    assert good["taken"] == "accepted" and wrong["taken"] in ("outlier", "unused")
    assert wrong["before"]["located"] < good["after"]["located"] == 5
    assert good["after"]["pair_error_m"] < 0.1 and good["after"]["sigma_m"] > 0
    assert report["against"] == "the true poses and depths"


def _pieces(session):
    """How many robots each piece has; either may hold the origin."""
    return sorted(Counter(pose.component for pose in session.poses().values()).values())


def _located(session):
    return sum(pose.located for pose in session.poses().values())
