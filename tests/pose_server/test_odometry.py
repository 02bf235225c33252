"""What robots say of their own motion, and where views hang by it that align with nothing."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.frontend.localization import MOST_BLIND
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose
from fleetpose.pose_server.state.odometry import Moment, Odometers, motion
from fleetpose.protocol.messages import Odometry
from tests.pose_server.scene import EPOCH, descriptors, view, walls
from tests.pose_server.test_flows import kept, named, site_of, work_off

SMALL = np.eye(6) * 1e-6
STEP_M = 0.3


def said(stamp_ns: int, T: np.ndarray, epoch: str = EPOCH, robot: str = "r1") -> Odometry:
    return Odometry(robot=robot, epoch=epoch, stamp_ns=stamp_ns, T_odom_robot=T, covariance=SMALL)


def walked(steps: int) -> np.ndarray:
    return make_pose(exp_so3(np.array([0.0, 0.0, 0.05 * steps])), np.array([STEP_M * steps, 0, 0]))


def test_motion_is_between_the_bodies_and_no_frame_of_odometry_matters():
    a, b = walked(1), walked(3)
    elsewhere = make_pose(exp_so3(np.array([0.3, -1.0, 2.0])), np.array([7.0, -5.0, 1.0]))
    T, covariance = motion(Moment(0, a, SMALL), Moment(1, b, SMALL))
    other, _ = motion(Moment(0, elsewhere @ a, SMALL), Moment(1, elsewhere @ b, SMALL))
    assert np.allclose(T, inverse(a) @ b)
    assert np.allclose(T, other)
    assert np.linalg.eigvalsh(covariance).min() > 0


def test_motion_is_less_sure_the_longer_it_is_and_the_more_the_robot_doubts_it():
    def size(steps: int, grown: float = 0.0) -> float:
        there = Moment(1, walked(steps), SMALL + np.eye(6) * grown)
        return float(np.trace(motion(Moment(0, walked(0), SMALL), there)[1]))

    assert size(0) < size(1) < size(5)
    assert size(1, grown=0.01) > size(1) + 0.05


def test_a_view_has_the_moment_near_its_stamp_or_none():
    odometers = Odometers()
    for k in range(10):
        odometers.note(said(k * 10**9, walked(k)))
    odometers.note(said(4 * 10**9, walked(0)))  # late: the newest is newer
    moment = odometers.at(named(4), 4 * 10**9 + 30_000_000)
    assert moment is not None and np.allclose(moment.T_odom_robot, walked(4))
    assert odometers.at(named(5), 5_500_000_000) is None
    assert odometers.at(named(6, "r2"), 6 * 10**9) is None
    odometers.note(said(7 * 10**9, walked(1), epoch="fedcba987654"))
    assert odometers.at(named(7), 7 * 10**9) is None  # another life has begun
    assert odometers.at(named(4), 4 * 10**9) is moment
    odometers.forget({named(4)})
    assert odometers.at(named(4), 4 * 10**9) is None


def site_that_walks_blindly(steps: int, tells: bool):
    """A robot that sees nothing of what it saw before in any of its views."""
    rng = np.random.default_rng(2)
    site = site_of(_unlike(rng, 0))
    _say(site, 0, tells)
    pipeline.solve(site, 0.0)
    for k in range(1, steps + 1):
        _say(site, k, tells)
        pipeline.receive_view(site, kept(_unlike(rng, k)))
        work_off(site)
    return site


def _unlike(rng: np.random.Generator, seq: int):
    message = view(rng, "r1", walls(rng, 300), descriptors(rng, 300), np.eye(4), seq=seq)
    return message.model_copy(update={"stamp_ns": seq * 10**9})


def _say(site, k: int, tells: bool) -> None:
    if tells:
        site.odometers.note(said(k * 10**9, walked(k)))
        site.odometers.at(named(k), k * 10**9)


@pytest.mark.parametrize("tells", [False, True])
def test_views_that_align_with_nothing_hang_by_odometry_where_there_is_any(tells):
    site = site_that_walks_blindly(2, tells)
    assert site.joined(named(0), named(2)) == tells
    if tells:
        T = site.relative(named(0), named(2))
        camera = site.views[named(0)].camera.T_robot_camera
        true = inverse(camera) @ inverse(walked(0)) @ walked(2) @ camera
        assert np.allclose(T, true, atol=1e-6)
        (first, second) = site.edges.values()
        assert {first.kind, second.kind} == {"odometry"}
        assert {first.verdict, second.verdict} == {"plausible"}


def test_a_robot_is_not_followed_blindly_for_ever():
    site = site_that_walks_blindly(MOST_BLIND + 1, tells=True)
    assert site.joined(named(0), named(MOST_BLIND))
    assert not site.joined(named(0), named(MOST_BLIND + 1))
    assert any("lost track of itself" in event for event in site.events)


def test_odometry_is_heard_again_after_the_robots_clock_was_set_back():
    site = site_that_walks_blindly(2, tells=True)
    early = _unlike(np.random.default_rng(5), 3).model_copy(update={"stamp_ns": 1})
    pipeline.receive_view(site, kept(early))
    site.odometers.note(said(2, walked(3)))
    assert site.odometers.at(named(9), 2) is not None
    assert any("went back" in event for event in site.events)
