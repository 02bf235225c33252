"""The paper's H*, H' and H in the messages of a live server, for 1, 2, 3, 4 and 6 clicks on a pair
that nothing else joins.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.fleet import open_link, plan_world, start_servers
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Alignment
from fleetpose.protocol.transport import SessionSettings, wait_until
from fleetpose.robot_agent.cameras.synthetic import SyntheticCamera, WorldLink
from fleetpose.robot_agent.client import FleetRobot
from tests.integration.test_fleet_of_processes import (
    FIRST_POSE_S,
    RADIUS_M,
    put,
    true_clicks,
    truth_of,
)

CLICK_S = 60.0
UP = np.array([0.0, 0.0, 1.0])
MODELS = {  # that so many points may determine: less where they happen to lie in one plane
    1: {"translation"},
    2: {"upright"},
    3: {"rigid"},
    4: {"rigid", "affine"},
    6: {"rigid", "affine", "projective"},
}


@pytest.mark.timeout(240)
def test_each_number_of_clicks_tells_its_own_pose_and_what_is_left_to_it(tmp_path):
    plan = plan_world(["r1", "r2"], tmp_path, moving=False, seed=0)
    skip = tmp_path / "skip.txt"
    skip.write_text("r1 r2\n")
    told: list[Alignment] = []
    with LocalFleet(tmp_path) as fleet:
        start_servers(fleet, plan, 2, tmp_path / "state", skip)
        link = open_link(fleet)
        observer = Observer(link, Keys(fleet.site))
        link.on_latched(
            Keys(fleet.site).alignment("r1", "r2"),
            lambda sample: told.append(unpack(Alignment, sample.payload, sample.encoding)),
        )
        session = SessionSettings(connect=(fleet.endpoint,), timeout_s=10.0)
        robots = [FleetRobot(robot.name, session, site=fleet.site) for robot in plan.robots]
        try:
            for robot, of in zip(robots, plan.robots, strict=True):
                camera = SyntheticCamera(WorldLink(of.data))
                frame = next(camera.frames())
                camera.close()
                T_world_camera = truth_of(tmp_path, robot.name) @ frame.model.T_robot_camera
                up = T_world_camera[:3, :3].T @ UP
                robot.push_frame(replace(frame, raw=(), up_camera=up, up_sigma_rad=0.01))
            assert wait_until(lambda: len(observer.poses()) == 2, FIRST_POSE_S)
            clicks = true_clicks(observer, tmp_path, fleet)
            for before, count in itertools.pairwise((0, *MODELS)):
                added = put(fleet, clicks[before:count])
                assert added.returncode == 0, added.stdout + added.stderr

                assert wait_until(lambda count=count: clicked(told) == count, CLICK_S), (
                    count,
                    told[-1:],
                    fleet.tail("server"),
                )
                check(told[-1], count)
        finally:
            for robot in robots:
                robot.close()
            observer.close()
            link.close()
    T = np.linalg.inv(truth_of(tmp_path, "r2")) @ truth_of(tmp_path, "r1")
    mount = frame.model.T_robot_camera
    T = np.linalg.inv(mount) @ T @ mount
    final = told[-1].operator
    assert np.linalg.norm(final.T_j_i_operator[:3, 3] - T[:3, 3]) < 0.1 * RADIUS_M
    assert np.linalg.norm((final.T_j_i_refine @ final.T_j_i_operator)[:3, 3] - T[:3, 3]) < (
        0.02 * RADIUS_M
    )


def clicked(told: list[Alignment]) -> int:
    operator = told[-1].operator if told else None
    return 0 if operator is None else len(operator.correspondences)


def check(alignment: Alignment, count: int) -> None:
    """H = H' . H* to the last digit that counts, and ICP says what it did."""
    operator = alignment.operator
    assert operator is not None and operator.model in MODELS[count]
    assert alignment.T_i_j is not None and operator.T_j_i_refine is not None
    T_j_i = np.linalg.inv(alignment.T_i_j)
    assert np.abs(operator.T_j_i_refine @ operator.T_j_i_operator - T_j_i).max() < 1e-9
    if alignment.icp is not None:
        assert alignment.icp.count > 0 and alignment.icp.ms > 0 and alignment.icp.rms_m > 0
