"""A local fleet's processes start, are watched, and all end, whatever ends first."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fleetpose.deploy.local_fleet import LocalFleet, ProcessEndedError, wait_running
from fleetpose.protocol.transport import wait_until

SERVE_FOREVER = ("http.server", "0", "--bind", "127.0.0.1")
WITH_STUBBORN_CHILD = """
import signal, subprocess, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
child = subprocess.Popen([sys.executable, "-c", "import signal; signal.pause()"])
print("child", child.pid, flush=True)
child.wait()
"""
PARENT = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job starts with it ignored
from pathlib import Path
from fleetpose.deploy.local_fleet import LocalFleet
with LocalFleet(Path(sys.argv[1])) as fleet:
    print(fleet.start("a", "http.server", "0", "--bind", "127.0.0.1"), flush=True)
    while True:
        signal.pause()
"""


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1][0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes `python -m <name>` run a given source in the children."""

    def make(name: str, source: str) -> str:
        folder = tmp_path / "modules"
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.py").write_text(source)
        monkeypatch.setenv("PYTHONPATH", str(folder))
        return name

    return make


def test_children_run_and_are_gone_after_close(tmp_path):
    with LocalFleet(tmp_path / "logs") as fleet:
        pids = [fleet.start(name, *SERVE_FOREVER) for name in ("a", "b")]
        assert wait_until(lambda: "Serving" in fleet.tail("a") + fleet.tail("b"), 30)
        assert all(alive(pid) for pid in pids)
        assert fleet.leftover_processes() == 2
        assert fleet.exited() == {}
    assert not any(alive(pid) for pid in pids)
    assert fleet.leftover_processes() == 0


def test_a_child_has_a_group_of_its_own_and_one_thread_per_library(tmp_path, module):
    name = module("shows_env", "import os\nprint(os.getpgrp(), os.environ['OMP_NUM_THREADS'])")
    with LocalFleet(tmp_path / "logs") as fleet:
        pid = fleet.start("a", name)
        assert wait_until(lambda: "a" in fleet.exited(), 30)
        assert fleet.tail("a") == f"{pid} 1"


def test_what_a_child_tells_in_json_is_kept_apart_from_its_log(tmp_path, module):
    source = """
import sys
for n in range(3):
    sys.stdout.write('{"n": %d}' % n)
    sys.stderr.write("a line of the log ")
    sys.stdout.write("\\n")
sys.stdout.write('{"n": ')
"""
    with LocalFleet(tmp_path / "logs") as fleet:
        fleet.start("a", module("tells", source), json_lines=True)
        assert wait_until(lambda: "a" in fleet.exited(), 30)
        assert fleet.told("a") == [{"n": 0}, {"n": 1}, {"n": 2}]
        assert fleet.tail("a") == "a line of the log " * 3


def test_children_that_ignore_sigterm_and_their_children_are_killed(tmp_path, module, monkeypatch):
    monkeypatch.setattr("fleetpose.deploy.local_fleet.GRACE_S", 0.5)
    with LocalFleet(tmp_path / "logs") as fleet:
        fleet.start("stubborn", module("stubborn", WITH_STUBBORN_CHILD))
        assert wait_until(lambda: len(fleet.tail("stubborn").split()) == 2, 30)
        grandchild = int(fleet.tail("stubborn").split()[1])
        assert fleet.leftover_processes() == 2
    assert not alive(grandchild)
    assert fleet.leftover_processes() == 0


def test_grandchildren_left_by_a_killed_child_are_ended_at_close(tmp_path, module):
    with LocalFleet(tmp_path / "logs") as fleet:
        fleet.start("stubborn", module("stubborn", WITH_STUBBORN_CHILD))
        assert wait_until(lambda: fleet.tail("stubborn").startswith("child"), 30)
        fleet.kill("stubborn")
        assert fleet.exited() == {}
        assert fleet.leftover_processes() == 1
    assert fleet.leftover_processes() == 0


def test_an_unexpected_end_is_told_with_the_end_of_the_log(tmp_path, module):
    name = module("fails", "raise SystemExit('no camera found')")
    with LocalFleet(tmp_path / "logs") as fleet:
        fleet.start("r1", name)
        assert wait_until(lambda: "r1" in fleet.exited(), 30)
        assert fleet.exited() == {"r1": "no camera found"}
        with pytest.raises(ProcessEndedError, match=r"r1 ended[^\n]*\nno camera found"):
            wait_running(fleet, lambda: False, 5)


def test_restart_gives_a_new_process_and_keeps_the_log(tmp_path):
    with LocalFleet(tmp_path / "logs") as fleet:
        first = fleet.start("a", *SERVE_FOREVER)
        assert wait_until(lambda: "Serving" in fleet.tail("a"), 30)
        fleet.restart("a")
        assert wait_until(lambda: fleet.tail("a").count("Serving") == 2, 30)
        assert fleet.pid("a") != first
        assert not alive(first)
        assert alive(fleet.pid("a"))
        assert fleet.exited() == {}


@pytest.mark.parametrize(
    "signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL], ids=lambda s: s.name
)
def test_the_fleet_ends_with_its_parent(tmp_path, signum):
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, str(tmp_path / "logs")],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert parent.stdout is not None
        child = int(parent.stdout.readline())
        assert alive(child)
        os.kill(parent.pid, signum)
        parent.wait(10)
        assert wait_until(lambda: not alive(child), 30)
    finally:
        parent.kill()
        parent.wait()
        parent.stdout.close()
