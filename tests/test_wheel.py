"""The wheel, installed beside a program whose own modules are called like our folders."""

import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
OWN_MODULES = ("protocol", "deploy", "evaluation", "settings")
PROGRAM = """
import deploy, evaluation, protocol, settings
import numpy as np
from fleetpose import Camera, DepthImage, FleetRobot, SessionSettings
from fleetpose.protocol.codec import pack, unpack
from fleetpose.protocol.messages import View, ViewName
from fleetpose.robot_agent.cameras.base import Frame
from fleetpose.robot_agent.features.keypoints import salient_of
from fleetpose.robot_agent.features.packing import view_of

for module in (deploy, evaluation, protocol, settings):
    assert module.MINE == module.__name__
noise = {"pixel_sigma_px": 0.5, "depth_sigma_m": (0.01, 0.0, 0.0)}
K = np.array([[50.0, 0, 31.5], [0, 50.0, 23.5], [0, 0, 1]])
model = Camera(kind="depth", width=64, height=48, K=K, T_robot_camera=np.eye(4), noise=noise)
image = np.random.default_rng(0).integers(0, 256, (48, 64, 3), np.uint8)
frame = Frame(0, image, DepthImage(np.full((48, 64), 2.0, np.float32)), model)
view = view_of(ViewName(robot="r1", epoch="0" * 12, seq=0), frame, salient_of(frame))
assert unpack(View, pack(view)).name == view.name
import fleetpose
print(fleetpose.__file__)
"""


def run(*command, **options) -> subprocess.CompletedProcess[str]:
    command = [str(part) for part in command]
    return subprocess.run(command, capture_output=True, text=True, timeout=150, **options)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Built from a copy: what an earlier build left beside the sources would get into it."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for folder in PYPROJECT["tool"]["setuptools"]["package-dir"].values():
        left_out = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / folder, source / folder, ignore=left_out)
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    built = run(sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", out, source)
    if "No matching distribution found for setuptools" in built.stderr:
        pytest.skip("no wheel can be built here: setuptools cannot be fetched")
    assert built.returncode == 0, built.stdout + built.stderr
    [made] = out.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The folder that it is installed into, without what it depends on: that is here already."""
    folder = tmp_path_factory.mktemp("installed")
    pip = (sys.executable, "-m", "pip", "install", "--no-deps", "--no-index", "--target", folder)
    done = run(*pip, wheel)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def programs_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("program")
    for name in OWN_MODULES:
        (folder / f"{name}.py").write_text(f"MINE = {name!r}\n")
    (folder / "program.py").write_text(PROGRAM)
    return folder


def contents(wheel) -> set[str]:
    with zipfile.ZipFile(wheel) as file:
        return set(file.namelist())


def test_it_takes_one_name_of_an_environment(wheel):
    names = {name.partition("/")[0] for name in contents(wheel)}
    version = PYPROJECT["project"]["version"]
    assert names == {"fleetpose", f"fleetpose-{version}.dist-info"}
    assert "fleetpose/py.typed" in contents(wheel)


def test_it_holds_every_file_of_every_folder(wheel):
    folders = PYPROJECT["tool"]["setuptools"]["package-dir"]
    there = {
        "/".join((*name.split("."), *path.relative_to(ROOT / folder).parts))
        for name, folder in folders.items()
        for path in (ROOT / folder).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in contents(wheel) if name.startswith("fleetpose/")} == there


def test_a_program_keeps_its_own_modules(installed, programs_folder):
    environment = os.environ | {"PYTHONPATH": str(installed)}
    done = run(sys.executable, "program.py", cwd=programs_folder, env=environment)
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()) == installed / "fleetpose" / "__init__.py"


@pytest.mark.parametrize("script", PYPROJECT["project"]["scripts"])
def test_every_command_starts_beside_such_a_program(installed, programs_folder, script):
    search = os.pathsep.join((str(installed), str(programs_folder)))
    environment = os.environ | {"PYTHONPATH": search, "PYTHONSAFEPATH": "1"}
    told = run(installed / "bin" / script, "--version", cwd=programs_folder, env=environment)
    assert told.stdout == f"{script} {PYPROJECT['project']['version']}\n", told.stderr
    done = run(installed / "bin" / script, "--help", cwd=programs_folder, env=environment)
    assert done.returncode == 0, done.stderr
    assert f"Usage: {script}" in done.stdout
