"""A robot's own program beside a real server: it never acts on a guess."""

import subprocess
import sys

import numpy as np
import pytest

from fleetpose.evaluation.system.fleet import open_link
from fleetpose.protocol.codec import encoding_of, pack, unpack
from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import RelativePose, RobotPose
from fleetpose.protocol.transport import SessionSettings, wait_until
from fleetpose.robot_agent.client import FleetRobot
from tests.integration.test_fleet_of_processes import FIRST_POSE_S, RADIUS_M, running

LIAR = "f" * 12
STALE_S = 60.0  # a pose is valid for 5 s; a busy machine tells late


def fit(program: FleetRobot) -> set[str]:
    """The robots whose poses a careful program acts on."""
    return {
        name
        for name, pose in program.poses().items()
        if pose.located and not program.is_stale(pose)
    }


def sigma_m(told: RelativePose) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(told.covariance[3:, 3:])[-1]))


@pytest.mark.timeout(240)
def test_a_program_acts_on_the_live_servers_fresh_poses_alone_and_hears_why_not(tmp_path):
    with running(tmp_path, 3) as (fleet, _):
        settings = SessionSettings(connect=(fleet.endpoint,), timeout_s=10.0)
        keys, link = Keys(fleet.site), open_link(fleet)

        def relative() -> RelativePose | None:
            try:
                answer = link.query(f"{keys.relative}?from=r1;to=r2")
            except UnreachableError:
                return None
            return unpack(RelativePose, answer.payload, answer.encoding)

        try:
            with (
                FleetRobot("watcher", settings, site=fleet.site) as program,
                FleetRobot("lost", settings, site="dmeo") as lost,
            ):
                assert wait_until(lambda: fit(program) == {"r1", "r2", "r3"}, FIRST_POSE_S)
                assert wait_until(lambda: (told := relative()) and told.located, FIRST_POSE_S)
                together = relative()
                assert together.verdict in ("verified", "plausible") and together.why_not == ""
                assert "no view arrived" in program.why()
                assert f"There is one at {fleet.site}." in lost.why() and not lost.poses()
                status = subprocess.run(
                    [sys.executable, "-m", "fleetpose.hmi_client", *fleet.connection, "status"],
                    capture_output=True,
                    text=True,
                    timeout=60,
                    check=True,
                )
                assert "3 of 4 robots located" in status.stdout, status.stdout

                true = program.poses()["r1"]
                T = true.T_fleet_robot.copy()
                T[0, 3] += 100.0
                forged = true.model_copy(
                    update={
                        "T_fleet_robot": T,
                        "server_epoch": LIAR,
                        "n": 10**9,
                        "valid_until_ns": true.valid_until_ns + 3600 * 10**9,
                    }
                )
                link.latched(keys.pose("r1")).put(pack(forged), encoding_of(RobotPose))
                assert wait_until(lambda: program.drops.total() > 0, STALE_S)
                assert program.drops == {"a pose of server _ that is not alive": 1}
                assert program.is_stale(forged) and program.poses()["r1"].server_epoch != LIAR

                fleet.kill("r2")
                assert wait_until(lambda: fit(program) == {"r1", "r3"}, STALE_S)
                assert wait_until(lambda: (told := relative()) and not told.located, STALE_S)
                assert "r2: its token is gone" in relative().why_not
                assert wait_until(lambda: "token is gone" in program.poses()["r2"].why_not, STALE_S)
                assert wait_until(
                    lambda: (told := relative()) and sigma_m(told) > 0.05 * RADIUS_M, 3 * STALE_S
                ), "of who is gone for long nobody knows where it is"

                fleet.kill("server")
                assert wait_until(lambda: not program.server_alive, STALE_S)
                assert wait_until(lambda: fit(program) == set(), STALE_S)
                assert "no server at site" in program.why()
        finally:
            link.close()
