"""What systemd is told, over a socket as it has one."""

import os
import signal
import socket
import subprocess
import sys

import pytest

from fleetpose.protocol.session import supervisor
from fleetpose.protocol.session.supervisor import Supervisor
from fleetpose.protocol.transport import free_port


@pytest.fixture
def systemd(tmp_path, monkeypatch):
    """The socket that a service's environment names."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as heard:
        heard.bind(str(tmp_path / "notify"))
        heard.settimeout(30)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        monkeypatch.delenv("WATCHDOG_PID", raising=False)
        monkeypatch.setenv("WATCHDOG_USEC", "30000000")
        yield heard


def said(heard: socket.socket) -> str:
    return heard.recv(4096).decode()


def test_it_is_told_what_it_asks_for(systemd, monkeypatch):
    monkeypatch.setattr(supervisor, "_LEAST_PAUSE_S", 0.0)
    ours = Supervisor()
    ours.ready()
    ours.alive("3 robots")
    ours.alive("3 robots")
    ours.stopping()
    expected = ["READY=1", "WATCHDOG=1\nSTATUS=3 robots", "WATCHDOG=1", "STOPPING=1"]
    assert [said(systemd) for _ in expected] == expected


def test_it_is_told_once_a_second_at_most(systemd):
    ours = Supervisor()
    for _ in range(100):
        ours.alive("here")
    assert "STATUS=here" in said(systemd)
    systemd.setblocking(False)
    with pytest.raises(BlockingIOError):
        said(systemd)


def test_another_process_watchdog_is_not_fed(systemd, monkeypatch):
    monkeypatch.setenv("WATCHDOG_PID", "1")
    Supervisor().alive("here")
    assert said(systemd) == "STATUS=here"


def test_elsewhere_nothing_happens(monkeypatch):
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    ours = Supervisor()
    ours.ready()
    ours.alive("here")


@pytest.mark.parametrize(
    ("module", "arguments"),
    [
        ("robot_agent", ("run", "--name", "r1", "--camera", "rgbd", "--data", "DATA")),
        ("pose_server", ("run", "--workers", "1", "--state-dir", "STATE")),
    ],
)
@pytest.mark.timeout(60)
def test_a_service_is_ready_and_alive_while_it_waits_for_a_router(
    systemd, tmp_path, module, arguments
):
    from tests.integration.test_processes import recording

    places = {"DATA": str(recording(tmp_path)), "STATE": str(tmp_path / "state")}
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-P", "-m", f"fleetpose.{module}"]
    command += [places.get(one, one) for one in arguments] + ["--connect", endpoint]
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL, env=dict(os.environ))
    try:
        assert said(systemd) == "READY=1"
        assert said(systemd) == f"WATCHDOG=1\nSTATUS=waiting for a router at {endpoint}"
        assert said(systemd) == "WATCHDOG=1"
        child.send_signal(signal.SIGTERM)
        assert child.wait(20) == 0
    finally:
        child.kill()
        child.wait()


@pytest.mark.timeout(60)
def test_a_router_is_ready_once_it_listens(systemd):
    listen = ("--listen", f"tcp/127.0.0.1:{free_port()}")
    command = [sys.executable, "-P", "-m", "fleetpose.pose_server", "router", *listen]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        assert said(systemd) == "READY=1"
        assert "WATCHDOG=1" in said(systemd)
        child.send_signal(signal.SIGTERM)
        assert child.wait(20) == 0
    finally:
        child.kill()
        child.wait()
