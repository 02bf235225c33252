"""The text client in a real terminal: joined by keys alone, picked to the pixel, read as shown."""

import json
import os
import shlex
import shutil
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.system.terminal.fingers import Eyes, arrow_keys
from fleetpose.evaluation.system.terminal.hmi import HmiOptions
from fleetpose.evaluation.system.terminal.hmi import run as run_hmi
from fleetpose.evaluation.system.terminal.operate import OperateOptions
from fleetpose.evaluation.system.terminal.operate import run as run_operate
from fleetpose.evaluation.system.terminal.reading import images_on
from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import free_port
from tests.data import shared_data

in_tmux = pytest.mark.skipif(shutil.which("tmux") is None, reason="no tmux")


@pytest.mark.parametrize(("du", "dv"), [(0, 0), (3, -4), (17, 26), (-95, 120)])
def test_arrows_lead_to_where_they_should_with_few_keys(du, dv):
    keys = arrow_keys(du, dv)
    steps = {"Left": (-1, 0), "Right": (1, 0), "Up": (0, -1), "Down": (0, 1)}
    moved = sum(
        (np.multiply(steps[k.removeprefix("S-")], 10 if k.startswith("S-") else 1) for k in keys),
        np.zeros(2),
    )
    assert tuple(moved) == (du, dv) and len(keys) <= abs(du) // 10 + abs(dv) // 10 + 12


def test_eyes_know_the_partner_of_a_pixel_near_a_known_one():
    eyes = Eyes(np.array([[10.0, 10.0]]), np.array([[50.0, 60.0]]), ((640, 480), (640, 480)))
    assert eyes.partner((12.0, 9.0)) == pytest.approx((52, 59))
    assert eyes.partner((40.0, 10.0)) is None


def test_image_panels_are_found_on_a_screen():
    lines = [
        "╭─ map ─╮┏━ r1  FROZEN ━━━━━━━━━┓",
        "│       │┃▀▀as▀▀▀▀▀▀ ▀▀▀▀▀▀▀▀▀▀┃",
        "│       │┃12, 34 px            ┃",
        "╰───────╯┗━━━━━━━━━━━━━━━━━━━━━━┛",
    ]
    [image] = images_on(lines)
    assert (image.robot, image.cursor, image.focused) == ("r1", (12.0, 34.0), True)
    assert (image.left, image.top, image.rows) == (10, 1, 2)


@in_tmux
def test_a_program_that_is_not_there_is_told():
    with pytest.raises(FleetPoseError), Terminal(["/nowhere/at-all"]) as terminal:
        terminal.wait_text("anything", 1.0)


@in_tmux
@pytest.mark.timeout(150)
def test_a_fleet_in_two_pieces_is_joined_by_keys_alone(tmp_path):
    data = shared_data("church_herzjesu")
    summary = run_operate(OperateOptions(data, "sparse_noisy"), tmp_path)
    assert summary["joined"] and summary["shown"] and summary["points"] == 3
    assert summary["verdict"] == "verified" and summary["ok"]
    assert summary["keys"] < 60
    assert len(list((tmp_path / "screens").glob("*.txt"))) >= 5


@in_tmux
@pytest.mark.timeout(150)
def test_a_server_killed_in_mid_click_costs_nothing_and_the_screen_says_so(tmp_path):
    data = shared_data("church_herzjesu")
    summary = run_operate(OperateOptions(data, "sparse_noisy", kill_server=True), tmp_path)
    assert summary["silence_said"] and summary["unconfirmed_said"] and summary["confirmed_said"]
    assert summary["lost"] == 0 and summary["points"] == 3
    assert summary["joined"] and summary["verdict"] == "verified" and summary["ok"]


@in_tmux
def test_what_was_drawn_over_and_other_sizes_are_drawn_anew(tmp_path):
    nobody = f"tcp/127.0.0.1:{free_port()}"
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "screen", "--connect", nobody]
    with Terminal(command, 120, 40, {"XDG_STATE_HOME": str(tmp_path)}) as terminal:
        whole = terminal.wait_text("Quit", 30.0)
        assert any("NO SERVER heard yet" in line for line in whole[-6:])
        terminal.spoil("\x1b[5;5Hsomebody else wrote this\x1b[9;1H\x1b[2K")
        terminal.wait_text("somebody else")
        terminal.press("C-l")
        terminal.wait(lambda lines: lines == whole, "what was there before")
        terminal.resize(100, 30)
        smaller = terminal.wait(lambda lines: len(lines) == 30 and "Quit" in lines[-1], "smaller")
        assert smaller[0].endswith("╮") and len(smaller[0]) == 100
        terminal.resize(120, 40)
        terminal.wait(lambda lines: lines == whole, "what was there before")


@in_tmux
def test_a_screen_that_is_ended_gives_the_terminal_back_as_it_was(tmp_path):
    screen = [sys.executable, "-P", "-m", "fleetpose.hmi_client", "screen", "--connect"]
    line = shlex.join([*screen, f"tcp/127.0.0.1:{free_port()}"])
    command = ["sh", "-c", f"echo before; {line}; echo ended with $?; exec sleep 600"]
    with Terminal(command, 120, 40, {"XDG_STATE_HOME": str(tmp_path)}) as terminal:
        terminal.wait_text("Quit", 30.0)
        (child,) = Path(f"/proc/{terminal.pid}/task/{terminal.pid}/children").read_text().split()
        os.kill(int(child), signal.SIGTERM)
        lines = terminal.wait_text("ended with 0", 30.0)
        assert lines[0] == "before" and not any("Quit" in line for line in lines)


@in_tmux
@pytest.mark.timeout(150)
def test_picks_by_keys_and_mouse_are_within_a_pixel(tmp_path):
    run_hmi(HmiOptions(robots=6, seconds=5.0, targets=6), tmp_path)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["pick_error_px_max_keys"] <= 1 and summary["pick_error_px_max_mouse"] <= 1
    assert summary["keys"] > 3 and summary["keys_lost"] == 0
    assert summary["key_after_stall_ms"] is not None  # a terminal that hung shows the present again
