"""The demo says whether it went well, and leaves nothing behind however it ends."""

import os
import pty
import select
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.metrics.fleet_scoring import SampleRow
from fleetpose.evaluation.system.demo import DemoResult, report, run, without_screen
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until


def row(robot: str, error_m: float, located: bool = True, is_anchor: bool = False) -> SampleRow:
    return SampleRow(0.0, robot, is_anchor, located, np.eye(4), np.eye(6), np.eye(4), error_m, 0.1)


GOOD = DemoResult([row("r1", 0.0, is_anchor=True), row("r2", 0.05), row("r3", 0.09)], 3, 10.0, 12.0)


def test_a_mean_error_below_1_percent_of_the_radius_is_good(capsys):
    assert GOOD.mean_error_m == pytest.approx(0.07)
    assert GOOD.good
    assert report(GOOD, leftover_processes=0) == 0
    printed = capsys.readouterr().out
    assert "0.700%" in printed
    assert "12.0 s after the processes were up" in printed


def test_a_large_error_a_lost_robot_or_a_leftover_process_is_not_good():
    assert report(replace(GOOD, rows=[*GOOD.rows[:2], row("r3", 0.2)]), 0) == 1
    assert report(replace(GOOD, rows=[*GOOD.rows[:2], row("r3", 0.01, located=False)]), 0) == 1
    assert report(replace(GOOD, rows=[]), 0) == 1
    assert report(GOOD, leftover_processes=1) == 1


def test_no_terminal_or_headless_means_no_screen(monkeypatch):
    for stream in ("stdin", "stdout"):
        monkeypatch.setattr(f"sys.{stream}.isatty", lambda: True, raising=False)
    monkeypatch.delenv("HEADLESS", raising=False)
    assert not without_screen(False)
    assert without_screen(True)
    monkeypatch.setenv("HEADLESS", "1")
    assert without_screen(False)
    monkeypatch.delenv("HEADLESS")
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert without_screen(False)


def test_one_robot_is_no_fleet():
    with pytest.raises(FleetPoseError, match="at least 2"):
        run(1, 90.0, "none")


def processes_with(temporary: Path) -> list[int]:
    """Ids of the processes that were started with this folder for temporary files."""
    wanted = f"TMPDIR={temporary}".encode()
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                environment = (entry / "environ").read_bytes()
            except OSError:  # it ended while we looked
                continue
            if wanted in environment.split(b"\0"):
                found.append(int(entry.name))
    return found


def test_hanging_up_the_terminal_ends_every_process(tmp_path):
    """On a real terminal, with the operator's screen drawn."""
    terminal, inner = pty.openpty()
    environment = {**os.environ, "TERM": "xterm-256color", "TMPDIR": str(tmp_path)}
    environment.pop("HEADLESS", None)
    demo = subprocess.Popen(
        [sys.executable, "-P", "-m", "fleetpose.evaluation", "demo", "--robots", "2"],
        stdin=inner,
        stdout=inner,
        stderr=inner,
        env=environment,
        start_new_session=True,
        preexec_fn=_take_terminal,
    )
    os.close(inner)
    try:
        drawn = b""
        end = time.monotonic() + 90
        while b"\x1b[?1049h" not in drawn and time.monotonic() < end:
            if select.select([terminal], [], [], 0.5)[0]:
                drawn += os.read(terminal, 65536)
        assert b"\x1b[?1049h" in drawn  # the screen took over the terminal
        assert len(processes_with(tmp_path)) >= 6  # demo, router, world, server, robots
        os.close(terminal)
        demo.wait(20)
        assert wait_until(lambda: not processes_with(tmp_path), 10)
    finally:
        demo.kill()
        demo.wait()


def _take_terminal() -> None:
    import fcntl
    import termios

    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
