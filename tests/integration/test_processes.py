"""Processes come, go and meet each other: signals, one server per site, one owner per journal."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.fleet import open_link, plan_world, start, wait_started
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import wait_until

END_S = 60.0
SAID_S = 60.0


@pytest.fixture
def fleet(tmp_path):
    with LocalFleet(tmp_path) as started:
        yield started


def server_alive(fleet: LocalFleet) -> list[str]:
    link = open_link(fleet)
    try:
        return link.alive(Keys(fleet.site).server_alive("*"))
    finally:
        link.close()


def run_server(fleet: LocalFleet, *options: str) -> subprocess.CompletedProcess[str]:
    """A server that is expected to end by itself."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "fleetpose.pose_server",
        "run",
        *fleet.connection,
        *options,
    ]
    return subprocess.run(command, capture_output=True, text=True, timeout=SAID_S, check=False)


def recording(folder: Path) -> Path:
    """Two frames of a camera that looks at a wall."""
    noise = np.random.default_rng(0).integers(0, 256, (120, 160, 3), np.uint8)
    for n in range(2):
        cv2.imwrite(str(folder / f"frame-{n:06d}.color.png"), cv2.GaussianBlur(noise, (0, 0), 1.5))
        wall = np.full((120, 160), 1500, np.uint16)
        cv2.imwrite(str(folder / f"frame-{n:06d}.depth.png"), wall)
    np.savetxt(folder / "camera-intrinsics.txt", [[150, 0, 80], [0, 150, 60], [0, 0, 1]])
    return folder


def ended(fleet: LocalFleet, name: str) -> int | None:
    """The exit code of a process of the fleet, None while it runs."""
    return fleet._children[name].process.poll()


def test_sigterm_ends_every_process_and_leaves_nothing(fleet, tmp_path):
    plan = plan_world(["r1", "r2"], tmp_path, moving=False, seed=0)
    start(fleet, plan, 2, tmp_path / "state")
    fleet.start("watch", "fleetpose.hmi_client", "watch", *fleet.connection)
    link = open_link(fleet)
    observer = Observer(link, Keys(fleet.site))
    try:
        wait_started(fleet, observer, 2)
        assert wait_until(lambda: len(observer.poses()) == 2, 60.0), "no poses"
        assert wait_until(lambda: "pose" in fleet.tail("watch"), 10.0), "nothing to watch"
    finally:
        observer.close()
        link.close()
    for name in ("watch", "r1", "server", "r2", "router", "world"):
        os.kill(fleet.pid(name), signal.SIGTERM)
        assert wait_until(lambda name=name: ended(fleet, name) is not None, END_S), name
        assert ended(fleet, name) in (0, -signal.SIGTERM), fleet.tail(name)
        assert "Traceback" not in fleet.tail(name, 50), fleet.tail(name)
    assert wait_until(lambda: fleet.leftover_processes() == 0, END_S), "a worker outlived them"


def test_a_second_server_of_a_site_is_refused_and_one_that_takes_over_ends_the_first(
    fleet, tmp_path
):
    fleet.start_router()
    fleet.start_server("--workers", "1")
    assert wait_until(lambda: len(server_alive(fleet)) == 1, SAID_S)
    (first,) = server_alive(fleet)

    other_state = ("--state-dir", str(tmp_path / "other"))
    refused = run_server(fleet, *other_state)
    assert refused.returncode == 2
    assert first in refused.stderr and "--takeover" in refused.stderr
    assert refused.stderr.count("\n") == 1 and "Traceback" not in refused.stderr

    in_use = run_server(fleet, "--takeover", "--state-dir", str(fleet.directory / "state"))
    assert in_use.returncode == 2
    assert f"in use by process {fleet.pid('server')}" in in_use.stderr
    assert server_alive(fleet) == [first], "it took nothing over, its journal is not its own"

    fleet.start(
        "second", "fleetpose.pose_server", "run", *fleet.connection, *other_state, "--takeover"
    )
    assert wait_until(lambda: ended(fleet, "server") is not None, SAID_S)
    assert ended(fleet, "server") == 2
    assert "was taken over" in fleet.tail("server")
    assert wait_until(lambda: first not in server_alive(fleet), SAID_S)
    assert len(server_alive(fleet)) == 1 and ended(fleet, "second") is None


def test_the_workers_of_a_killed_server_end_with_it(fleet):
    fleet.start_router()
    fleet.start_server("--workers", "2")
    assert wait_until(lambda: len(server_alive(fleet)) == 1, SAID_S)
    assert fleet.leftover_processes() >= 4, "router, server and two workers"
    fleet.kill("server")
    assert wait_until(lambda: fleet.leftover_processes() == 1, SAID_S), "only the router is left"


def test_a_taken_port_is_said_in_a_sentence(fleet):
    fleet.start_router()
    command = [
        sys.executable,
        "-P",
        "-m",
        "fleetpose.pose_server",
        "router",
        "--listen",
        fleet.endpoint,
    ]
    second = subprocess.run(command, capture_output=True, text=True, timeout=SAID_S, check=False)
    assert second.returncode == 2
    assert fleet.endpoint in second.stderr and "Traceback" not in second.stderr


def test_processes_start_in_any_order_and_say_what_they_wait_for(fleet, tmp_path):
    start_processes = ("server", "r1", "watch")
    fleet.start_server("--workers", "1")
    fleet.start_robot("r1", "rgbd", str(recording(tmp_path)), "--replay", "loop")
    fleet.start("watch", "fleetpose.hmi_client", "watch", *fleet.connection)
    waits = f"no zenoh router at {fleet.endpoint}"
    for name in start_processes:
        assert wait_until(lambda name=name: waits in fleet.tail(name), SAID_S), fleet.tail(name)
    fleet.start_router()
    assert wait_until(lambda: "pose" in fleet.tail("watch"), 60), fleet.tail("watch")
    assert not fleet.exited()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_who_waits_for_a_router_can_be_asked_to_end(fleet, tmp_path, number):
    fleet.start_server("--workers", "1")
    assert wait_until(lambda: "waiting for it" in fleet.tail("server"), SAID_S)
    os.kill(fleet.pid("server"), number)
    assert wait_until(lambda: ended(fleet, "server") is not None, END_S)
    assert ended(fleet, "server") == 0 and "Traceback" not in fleet.tail("server")
    assert wait_until(lambda: fleet.leftover_processes() == 0, SAID_S)
