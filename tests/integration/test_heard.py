"""What the server has of a robot, and refuses of it, is told to the robot and to who asks why."""

import subprocess
import sys

import cv2
import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel
from fleetpose.protocol.transport import SessionSettings, wait_until
from fleetpose.robot_agent.client import FleetRobot

MODEL = Camera(
    width=160,
    height=120,
    K=np.array([[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]]),
    T_robot_camera=ROBOT_FROM_CAMERA,
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001)),
    kind="rgbd",
)
IMAGE = cv2.GaussianBlur(
    np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8), (0, 0), 1.5
)
WALL = np.full((120, 160), 1.5, np.float32)
NOTHING = np.full((120, 160), np.nan, np.float32)


@pytest.mark.timeout(120)
def test_a_robot_is_told_that_its_views_are_refused_and_that_they_are_taken(tmp_path):
    with LocalFleet(tmp_path) as fleet:
        fleet.start_router()
        fleet.start_server("--workers", "1")
        settings = SessionSettings(connect=(fleet.endpoint,))
        with FleetRobot("r1", settings, site=fleet.site, camera=MODEL) as robot:

            def refused():
                robot.push(np.zeros_like(IMAGE), NOTHING)
                return "its views are refused" in robot.why()

            assert wait_until(refused, 40, poll_s=0.3), robot.why()
            command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "why", "r1"]
            command += fleet.connection
            said = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
            assert "0 points with depth" in said.stdout and said.returncode == 1, said
            assert robot.heard_age_s is None
            heard = robot._hearing.newest
            assert heard is not None and sum(heard.drops.values()) > 0

            def taken():
                robot.push(IMAGE, WALL)
                return robot.heard_age_s is not None

            assert wait_until(taken, 20, poll_s=0.3)
            assert wait_until(lambda: robot._sender.unheard_s() == 0.0, 30)
            assert "refused" not in robot.why()
