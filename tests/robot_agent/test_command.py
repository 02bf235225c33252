"""The command `robot-agent`, as a process."""

import os
import signal
import subprocess
import sys
import tomllib

import cv2
import numpy as np
import pytest

from fleetpose.protocol.codec import unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import View
from fleetpose.protocol.transport import free_port, wait_until
from tests.robot_agent.test_client import pose_message, pose_publisher, publish

KEYS = Keys("demo")


@pytest.fixture
def recording(tmp_path):
    rng = np.random.default_rng(0)
    for n in range(4):
        image = cv2.GaussianBlur(rng.integers(0, 256, (120, 160, 3), np.uint8), (0, 0), 1.5)
        cv2.imwrite(str(tmp_path / f"frame-{n:06d}.color.png"), image)
        cv2.imwrite(
            str(tmp_path / f"frame-{n:06d}.depth.png"), np.full((120, 160), 1500, np.uint16)
        )
    np.savetxt(tmp_path / "camera-intrinsics.txt", [[150, 0, 80], [0, 150, 60], [0, 0, 1]])
    return tmp_path


@pytest.fixture
def start():
    """Starts agents: `start("--name", "r1", ...)`; whatever still runs at the end is killed."""
    children = []

    def run(*arguments, **environment):
        children.append(
            subprocess.Popen(
                [sys.executable, "-P", "-m", "fleetpose.robot_agent", "run", *arguments],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
            )
        )
        return children[-1]

    yield run
    for child in children:
        if child.poll() is None:
            child.kill()
        child.communicate()


def camera_options(recording, replay):
    return ("--camera", "rgbd", "--data", str(recording), "--replay", replay, "--rate", "3")


def test_a_recording_shown_once_arrives_whole_and_ends_well(start, router, link, recording):
    clouds = link.on_bulk(KEYS.cloud("r1"))
    agent = start("--name", "r1", "--connect", router, *camera_options(recording, "once"))
    seen = []
    while (sample := clouds.take(15 if len(seen) < 4 else 0)) is not None:
        seen.append(unpack(View, sample.payload, sample.encoding).name.seq)
    assert seen == [0, 1, 2, 3]
    _, log = agent.communicate(timeout=10)
    assert agent.returncode == 0
    assert log.count(" view name=r1/") == 4
    assert "reason=no more frames" in log
    assert link.alive(KEYS.robot_alive("r1", "*")) == []


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it(start, router, link, recording, number):
    agent = start("--name", "r1", "--connect", router, *camera_options(recording, "loop"))
    clouds = link.on_bulk(KEYS.cloud("r1"))
    assert clouds.take(20) is not None
    agent.send_signal(number)
    _, log = agent.communicate(timeout=30)
    assert agent.returncode == 0
    assert "reason=asked" in log
    assert link.alive(KEYS.robot_alive("r1", "*")) == []


def test_it_ends_with_the_process_that_started_it(router, link, recording):
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            "import subprocess, sys; subprocess.Popen(sys.argv[1:]); sys.stdin.read()",
            *(sys.executable, "-P", "-m", "fleetpose.robot_agent", "run", "--name", "r1"),
            *("--connect", router, "--end-with-parent"),
            *camera_options(recording, "loop"),
        ],
        stdin=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    alive = KEYS.robot_alive("r1", "*")
    try:
        assert wait_until(lambda: link.alive(alive), 20, poll_s=0.1)
    finally:
        parent.kill()
        parent.communicate()
    assert wait_until(lambda: not link.alive(alive), 5, poll_s=0.1)


def read_until(agent, words):
    """The lines that an agent logs, up to one with these words."""
    said = []
    for line in agent.stderr:
        said.append(line)
        if words in line:
            return said
    raise AssertionError("".join(said))


@pytest.mark.timeout(60)
def test_an_agent_at_a_mistyped_site_says_that_no_server_is_there(start, router, link, recording):
    link.token(KEYS.server_alive("0" * 12))
    options = camera_options(recording, "loop")
    agent = start("--name", "r1", "--connect", router, "--site", "dmeo", *options)
    said = read_until(agent, "no server at site 'dmeo': is the site name right")
    assert any("started name=r1" in line for line in said)


@pytest.mark.timeout(60)
def test_an_agent_logs_whether_it_is_located_and_why_not(start, router, link, recording):
    server = pose_publisher(link)
    agent = start("--name", "r1", "--connect", router, *camera_options(recording, "loop"))
    publish(server, pose_message(n=1))
    read_until(agent, "located name=r1 component=r1")
    doubt = {"located": False, "why_not": "the links to it contradict each other"}
    publish(server, pose_message(n=2).model_copy(update=doubt))
    said = read_until(agent, "not located name=r1 reason=the links to it contradict each other")
    assert not any("no server" in line for line in said)


def test_a_name_in_use_ends_it_with_one_sentence(start, router, link, recording):
    link.token(KEYS.robot_alive("r1", "0" * 12))
    agent = start("--name", "r1", "--connect", router, *camera_options(recording, "loop"))
    _, log = agent.communicate(timeout=20)
    assert agent.returncode == 2
    assert "already alive" in log
    assert "Traceback" not in log


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--camera", "rgbd"), "'name'"),
        (("--name", "R 1", "--camera", "rgbd"), "'name'"),
        (("--name", "r1", "--camera", "sonar"), "'camera'"),
        (("--name", "r1", "--camera", "rgbd", "--rate", "0"), "'rate_hz'"),
        (("--name", "r1", "--camera", "rgbd", "--data", "nowhere"), "nowhere"),
        (("--name", "r1", "--camera", "rgbd", "--settings", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_a_wrong_setting_ends_it_with_one_sentence(start, arguments, sentence):
    agent = start(*arguments)
    _, log = agent.communicate(timeout=20)
    assert agent.returncode == 2
    assert sentence in log
    assert "Traceback" not in log


def test_no_router_ends_it_with_one_sentence(start, recording):
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    agent = start(
        *("--name", "r1", "--connect", endpoint),
        *camera_options(recording, "once"),
        FLEETPOSE_ROBOT_CONNECT_TIMEOUT_S="0.3",
    )
    _, log = agent.communicate(timeout=20)
    assert agent.returncode == 2
    assert f"no zenoh router at {endpoint}" in log
    assert "Traceback" not in log


def test_the_command_line_goes_before_the_environment_before_the_file(start, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text('name = "r1"\nsite = "file"\njpeg_quality = 70\nrate_hz = 2\n')
    agent = start(
        *("--settings", str(file), "--camera", "rgbd", "--rate", "4", "--dump-settings"),
        FLEETPOSE_ROBOT_SITE="environment",
        FLEETPOSE_ROBOT_RATE_HZ="3",
    )
    out, _ = agent.communicate(timeout=20)
    dumped = tomllib.loads(out)
    assert (dumped["site"], dumped["jpeg_quality"], dumped["rate_hz"]) == ("environment", 70, 4)
    file.write_text(out)
    again = start("--settings", str(file), "--dump-settings")
    assert again.communicate(timeout=20)[0] == out


def test_help_does_not_import_what_is_heavy():
    code = (
        "import sys, runpy; sys.argv = ['robot-agent', 'run', '--help']\n"
        "try: runpy.run_module('fleetpose.robot_agent', run_name='__main__')\n"
        "except SystemExit: pass\n"
        "print([m for m in ('cv2', 'zenoh', 'numpy') if m in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=30, check=True
    )
    assert "--end-with-parent" in done.stdout
    assert done.stdout.splitlines()[-1] == "[]"
