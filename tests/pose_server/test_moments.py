"""Depths of another moment than their image, and clocks that are off."""

import numpy as np
import pytest

from fleetpose.pose_server.calibration.clocks import KEPT_VIEWS, Clocks
from fleetpose.pose_server.calibration.depth_shift import DepthShift, depth_shift
from fleetpose.pose_server.calibration.time_offset import TimeOffsets, depth_time_offset
from fleetpose.protocol.messages import ViewName

SIZE = (640, 480)


def houses(uv):
    """Inverse depths (N,) of walls of different depth side by side, some of them slanted."""
    wall = (uv[:, 0] // 90).astype(int)
    near = np.array((0.05, 0.12, 0.07, 0.15, 0.06, 0.1, 0.13, 0.08, 0.11))[wall % 9]
    storey = 1 + 0.3 * (uv[:, 1] // 130 % 2)
    return near * storey * (1 + 0.0005 * (uv[:, 0] - 90 * wall))


def shifted(shift, noise=0.01, scene=houses, points=300):
    """What is found for a view whose depths lie aside by so much."""
    rng = np.random.default_rng(3)
    cloud_uv = rng.uniform((0, 0), np.array(SIZE) - 1, (20_000, 2))
    cloud_q = scene(np.clip(cloud_uv - shift, 0, np.array(SIZE) - 1))
    uv = rng.uniform((50, 40), np.array(SIZE) - (50, 40), (points, 2))
    expected = scene(uv) * np.exp(noise * rng.standard_normal(points))
    return depth_shift(SIZE, cloud_uv, cloud_q, uv, expected, np.full(points, noise))


@pytest.mark.parametrize("shift", [(0, 0), (17, 0), (-26, 4), (8, -9)])
def test_depths_that_lie_aside_are_found_there(shift):
    found = shifted(np.array(shift))
    assert found is not None
    assert np.abs(found.shift_px - shift).max() < 2.5
    assert found.sigma_px.max() < 4.0


def test_a_wrong_baseline_is_no_shift():
    found = shifted(np.zeros(2), scene=lambda uv: houses(uv) * 1.0)
    longer = shifted(np.zeros(2), scene=lambda uv: houses(uv) / 1.05)
    assert found is not None and longer is not None
    assert np.allclose(found.shift_px, longer.shift_px, atol=1.0)


def test_a_plain_wall_and_few_points_tell_nothing():
    flat = shifted(np.zeros(2), scene=lambda uv: np.full(len(uv), 0.1))
    assert flat is None or flat.sigma_px.min() > 2.0
    assert shifted(np.zeros(2), points=20) is None


def said(offset_s, flows, seed=0):
    rng = np.random.default_rng(seed)
    sigmas = np.full(flows.shape, 1.5)
    return depth_time_offset(
        -offset_s * flows + 1.5 * rng.standard_normal(flows.shape), sigmas, flows
    )


def flows_of_a_robot_that_turns(views=12):
    return np.column_stack((45 * np.sin(np.arange(views)), np.zeros(views)))


@pytest.mark.parametrize("offset_s", [0.2, -0.12])
def test_the_offset_is_how_the_shift_follows_the_motion(offset_s):
    found = said(offset_s, flows_of_a_robot_that_turns())
    assert found is not None
    assert found.value == pytest.approx(offset_s, abs=4 * found.sigma)


@pytest.mark.parametrize("seed", range(20))
def test_depths_of_the_same_moment_or_of_a_robot_that_stands_still_are_right(seed):
    assert said(0.0, flows_of_a_robot_that_turns(), seed) is None
    assert said(0.2, np.zeros((12, 2)), seed) is None


def test_a_few_wrong_shifts_do_not_matter():
    flows = flows_of_a_robot_that_turns()
    shifts = -0.2 * flows
    shifts[::5] += 40.0
    found = depth_time_offset(shifts, np.full(flows.shape, 1.5), flows)
    assert found is not None and found.value == pytest.approx(0.2, abs=0.03)


def test_moments_wait_for_the_motion_and_are_forgotten_with_the_calibration():
    moments = TimeOffsets()
    names = [ViewName(robot="r1", epoch="0" * 12, seq=seq) for seq in range(12)]
    for seq, name in enumerate(names[1:], start=1):
        flow = 45 * np.sin(seq)
        moments.note(names[0], name, DepthShift(np.array((-0.2 * flow, 0.0)), np.full(2, 1.5)))
    assert moments.offset("r1") is None and moments.without_flow("r1") <= set(names)
    for seq, name in enumerate(names):
        moments.note_flow(name, np.array((45 * np.sin(seq), 0.0)))
    found = moments.offset("r1")
    assert found is not None and found.value == pytest.approx(0.2, abs=0.01)
    moments.forget("r1")
    assert moments.offset("r1") is None and moments.robots == []


def told(clocks):
    return dict(clocks.wrong())


def arrivals(ahead_s, late_s=0.4, views=KEPT_VIEWS, clocks=None, robot="r2", later_s=1.5):
    clocks = clocks or Clocks()
    for extra_s in np.linspace(0.0, later_s, views):  # some views are later than others
        clocks.note(robot, "0" * 12, ahead_s - late_s - extra_s)
    return clocks


def test_a_clock_ahead_or_behind_is_told_by_the_quickest_view():
    assert told(arrivals(3.0)) == {"r2": pytest.approx(2.6)}
    assert told(arrivals(-3.0)) == {"r2": pytest.approx(-3.4)}


def test_right_clocks_and_late_views_are_no_alarm():
    assert told(arrivals(0.0)) == told(arrivals(0.0, late_s=2.0)) == {}
    assert told(arrivals(3.0, views=3)) == {}
    assert told(arrivals(0.0, late_s=3.0, later_s=5.0)) == {}  # by another time each: a busy robot


def test_a_robot_that_plays_a_recording_has_no_wrong_clock_and_another_life_of_it_may():
    clocks = arrivals(-1e8)
    clocks.note_recorded("r2", "0" * 12, recorded=True)
    assert told(arrivals(-1e8, clocks=clocks)) == {}
    for _ in range(KEPT_VIEWS):
        clocks.note("r2", "1" * 12, 3.0)
    assert told(clocks) == {"r2": pytest.approx(3.0)}
    clocks.note_recorded("r2", "0" * 12, recorded=False)
    clocks.forget("r2")
    assert told(arrivals(3.0, clocks=clocks)) == {"r2": pytest.approx(2.6)}


def test_where_all_views_are_late_the_machine_is_slow():
    clocks = Clocks()
    for robot in ("r1", "r2", "r3"):
        arrivals(0.0, late_s=4.0, clocks=clocks, robot=robot)
    assert told(clocks) == {}
    arrivals(3.0, late_s=0.2, clocks=clocks, robot="r4")
    assert told(clocks) == {"r4": pytest.approx(2.8)}


def test_a_new_life_begins_with_nothing_and_who_is_gone_is_forgotten():
    clocks = arrivals(3.0)
    clocks.note("r2", "1" * 12, -0.3)
    assert told(clocks) == {}
    gone = arrivals(3.0)
    gone.keep_only(set())
    assert told(gone) == {}


def test_a_robot_whose_first_views_are_late_while_all_start_up_has_no_wrong_clock():
    clocks = Clocks()
    for _ in range(KEPT_VIEWS - 1):
        clocks.note("r2", "a", -4.3)
        assert not list(clocks.wrong())
    clocks.note("r2", "a", -4.3)
    assert list(clocks.wrong()) == [("r2", -4.3)], "late for good: its clock is behind"
