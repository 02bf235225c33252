"""What all commands have in common: their version, and what they say where an extra is missing."""

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions, version
from pathlib import Path

import cv2
import numpy as np
import pytest

from fleetpose.protocol.commands import MODULES, PARTS, require

SETUP = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]
PACKAGES = {  # by the names of their commands
    name: target.removesuffix(".__main__:main") for name, target in SETUP["scripts"].items()
}
OWN_SET_UP = ("rerun",)  # extras that `all` does not bring
EVERYTHING = [
    module for extra, modules in MODULES.items() if extra not in OWN_SET_UP for module in modules
]
RUN = ("run", "--listen", "tcp/127.0.0.1:0", "--state-dir", ".")
ROBOT = ("run", "--name", "r1", "--camera", "rgbd", "--data", "nowhere")
CHECK = ("calibrate-check", "--data", ".", "--calibration", "rig.yaml")
SCREENSHOT = ("screenshot", "--out", "nowhere.svg")


def blocked(folder, module, command, *arguments) -> subprocess.CompletedProcess[str]:
    """Runs a command in a folder, where a module is not installed."""
    code = (
        f"import sys; sys.modules[{module!r}] = None; sys.argv = sys.argv[1:]\n"
        f"from {PACKAGES[command]}.__main__ import main; main()"
    )
    return subprocess.run(
        [sys.executable, "-P", "-c", code, command, *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=120,
    )


@pytest.mark.parametrize("command", PACKAGES)
def test_a_command_tells_the_version_of_the_package(command):
    done = subprocess.run(
        [sys.executable, "-P", "-m", PACKAGES[command], "--version"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (0, f"{command} {version('fleetpose')}\n")


@pytest.mark.parametrize(
    ("command", "module", "extra", "arguments"),
    [
        ("robot-agent", "cv2", "robot", ROBOT),
        ("robot-agent", "yaml", "robot", CHECK),
        *(("pose-server", module, "server", RUN) for module in MODULES["server"]),
        ("pose-server", "gtsam", "server", ("export", "--out", "session")),
        ("pose-server", "open3d", "server", (*RUN, "--icp", "point_to_plane")),
        ("pose-server", "distributed", "cluster", (*RUN, "--cluster", "tcp://127.0.0.1:9")),
        ("pose-server", "prometheus_client", "metrics", (*RUN, "--metrics", "0")),
        ("pose-server", "mcap", "record", ("record", "--out", "a.mcap")),
        ("pose-server", "rerun", "rerun", ("show", "a.mcap", "--rrd", "a.rrd")),
        *(
            ("pose-server", module, "record", ("show", "a.mcap", "--foxglove", "b.mcap"))
            for module in MODULES["record"]
        ),
        *(("hmi-client", module, "hmi", SCREENSHOT) for module in MODULES["hmi"]),
        ("pose-eval", "psutil", "eval", ("solve", "--out", "nowhere")),
        ("pose-deploy", "gtsam", "robot,server", ("local", "--robots", "r1=rgbd:nowhere")),
    ],
)
def test_a_missing_extra_is_named_in_one_sentence(tmp_path, command, module, extra, arguments):
    for eye in ("left", "right"):
        (tmp_path / eye).mkdir()
        cv2.imwrite(str(tmp_path / eye / "0.png"), np.zeros((48, 64), np.uint8))
    (tmp_path / "rig.yaml").write_text("cam0: {}\n")
    done = blocked(tmp_path, module, command, *arguments)
    assert done.returncode == 2, done.stderr
    assert f"pip install 'fleetpose[{extra}]'" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("module", EVERYTHING)
def test_what_children_import_is_looked_for_before_they_start(monkeypatch, module):
    extra = next(extra for extra, modules in MODULES.items() if module in modules)
    require(extra)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ModuleNotFoundError) as missing:
        require(extra)
    assert missing.value.name == module


def test_help_can_be_read_where_nothing_is_installed(tmp_path):
    done = blocked(tmp_path, "scipy", "pose-eval", "pairs", "--help")
    assert done.returncode == 0 and "--mirror-share" in done.stdout


def test_a_module_of_no_extra_is_a_bug_and_no_sentence(tmp_path):
    done = blocked(tmp_path, "sqlite3", "pose-server", "export", "--out", "nowhere")
    assert done.returncode == 1 and "Traceback" in done.stderr


def plain(distribution: str) -> str:
    return distribution.lower().replace("_", "-")


def test_extras_bring_the_modules_that_they_are_said_to_bring():
    distributions = packages_distributions()
    for extra, modules in MODULES.items():
        told = SETUP["optional-dependencies"][extra]
        own = {plain(re.split(r"[\[>=<; ]", one)[0]) for one in told}
        for module in (
            () if extra in OWN_SET_UP else modules
        ):  # a distribution that does not tell what it brings is called alike
            brought_by = {plain(name) for name in distributions.get(module, [module])}
            assert own & brought_by, (extra, module)


def test_parts_of_extras_are_those_of_the_package():
    for extra, parts in PARTS.items():
        [told] = [
            one for one in SETUP["optional-dependencies"][extra] if one.startswith("fleetpose[")
        ]
        assert told == f"fleetpose[{','.join(parts)}]"
