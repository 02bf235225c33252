"""Robots that run ROS 2, stood in for on a router of this machine."""

import threading
import time
from contextlib import ExitStack, contextmanager

import numpy as np
import pytest

from fleetpose.evaluation.system.ros.speaking import DIALECTS, Node
from fleetpose.evaluation.system.ros.stand_in import Sight, StandIn
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from fleetpose.robot_agent.cameras.base import CameraError, DepthImage
from fleetpose.robot_agent.cameras.ros import camera as ros_camera
from fleetpose.robot_agent.cameras.ros import finding
from fleetpose.robot_agent.cameras.ros.camera import open_camera
from fleetpose.robot_agent.cameras.ros.options import RosOptions
from tests.rosmsg import bag_makers as makers

RATE_HZ = 30.0
PAIR_BYTES = makers.WIDTH * makers.HEIGHT * 5
T_BASE_OPTICAL = makers.T_BASE_LINK @ makers.T_LINK_OPTICAL


@contextmanager
def robot(router, dialect="jazzy"):
    """A robot whose nodes publish; gives the stand-in."""
    made = makers.source(7)
    colours = [np.ascontiguousarray(one[..., ::-1]) for one in made.colours]
    sight = Sight(colours, made.depths, makers.K, T_BASE_OPTICAL, np.eye(4))
    stop = threading.Event()
    with ExitStack() as closing:
        link = Link(open_session(SessionSettings(connect=(router,))))
        closing.callback(link.close)
        stand_in = StandIn(Node(link, dialect), "/site/Alpha", sight)
        thread = threading.Thread(target=stand_in.run, args=(stop, RATE_HZ), daemon=True)
        thread.start()
        closing.callback(thread.join)
        closing.callback(stop.set)
        yield stand_in


@contextmanager
def camera(router, waiting=lambda status: None, **options):
    opened = open_camera(
        router, "once", ros=RosOptions(**options), stop=threading.Event(), waiting=waiting
    )
    try:
        yield opened
    finally:
        opened.close()


@pytest.mark.parametrize("dialect", DIALECTS)
def test_frames_of_a_robot_are_pairs_of_one_moment_with_its_odometry(router, dialect):
    with robot(router, dialect) as stand_in, camera(router, namespace="/site/Alpha") as opened:
        colours = makers.source(7).colours
        frames = [next(opened.frames()) for _ in range(3)]
        for frame in frames:
            assert abs(time.time_ns() - frame.stamp_ns) < 5e9
            assert any(np.array_equal(frame.image, one) for one in colours)
            assert isinstance(frame.ranges, DepthImage)
            assert np.allclose(frame.model.T_robot_camera, T_BASE_OPTICAL, atol=1e-9)
            assert frame.odometry is not None
            assert np.allclose(frame.odometry.T_odom_robot, np.eye(4))
        assert len({frame.stamp_ns for frame in frames}) == 3
        assert not opened.network.drops and not stand_in.silent


def test_what_is_not_asked_for_is_not_sent(router):
    with robot(router), camera(router) as opened:
        frames = opened.frames()
        next(frames)
        time.sleep(0.2)
        before = opened.network.taken_bytes
        time.sleep(0.5)
        small = opened.network.taken_bytes - before
        assert 0 < small < 15 * 3000, "odometry goes on, images do not"
        next(frames)
        assert opened.network.taken_bytes - before - small < 5 * PAIR_BYTES


def test_a_topic_that_falls_silent_is_told_and_comes_back(router, monkeypatch, caplog):
    monkeypatch.setattr(ros_camera, "SILENT_S", 0.3)
    caplog.set_level("INFO", "fleetpose")
    told = []
    with robot(router) as stand_in, camera(router, told.append) as opened:
        depth = opened.sensor.roles.ranges
        next(opened.frames())
        stand_in.silent.add(depth)
        got = []
        thread = threading.Thread(target=lambda: got.append(next(opened.frames())), daemon=True)
        thread.start()
        assert wait_until(lambda: f"silent: {depth}" in told, 10)
        assert not got and "silent topics=" in caplog.text
        stand_in.silent.clear()
        thread.join(10)
        assert got and "heard again" in caplog.text


def test_a_camera_that_is_not_there_is_said_with_what_is(router, monkeypatch):
    monkeypatch.setattr(finding, "FOUND_WITHIN_S", 0.0)
    monkeypatch.setattr(finding, "LOOK_S", 0.5)
    with pytest.raises(CameraError, match="no topics are shown there"), camera(router):
        pass
    with robot(router) as stand_in:
        stand_in.silent.add("/site/Alpha/camera/aligned_depth_to_color/image_raw")
        with pytest.raises(CameraError) as refused, camera(router):
            pass
        said = str(refused.value)
        assert "images, but no depths" in said and "/site/Alpha/odom" in said
        assert "silent are: /site/Alpha/camera/aligned_depth_to_color/image_raw" in said
        with pytest.raises(CameraError, match="below '/r2'"), camera(router, namespace="/r2"):
            pass
