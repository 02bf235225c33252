"""Published benchmarks in their own folders: read right, played as a fleet, scored as papers do."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.evaluation.bench.published.command import robots_of, run
from fleetpose.evaluation.bench.published.papers import REPORTED
from fleetpose.evaluation.metrics.trajectory_error import trajectory_error
from fleetpose.evaluation.options.published import BenchOptions
from fleetpose.formats.rotations import pose_of
from fleetpose.formats.tum import read_tum
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.factory import open_camera
from tests.evaluation.folder_makers import MAKERS, walk

COUNT = 4


def options(layout: str, data, robots: str, **more) -> BenchOptions:
    return BenchOptions(layout, data, robots, **{"every": 1, **more})


@pytest.mark.parametrize("layout", MAKERS)
def test_each_layout_gives_true_cameras_and_folders_that_cameras_read(tmp_path, layout):
    poses = walk(COUNT)
    name = MAKERS[layout](tmp_path / "data", poses)
    robots = robots_of(options(layout, tmp_path / "data", name, split=2))
    assert [len(robot.shots) for robot in robots] == [2, 2]
    shots = [shot for robot in robots for shot in robot.shots]
    for shot, T in zip(shots, poses, strict=True):
        assert shot.T_world_camera is not None and np.allclose(shot.T_world_camera, T, atol=1e-6)
    folder = robots[1].stripped(tmp_path / "robot")
    frames = list(open_camera(robots[1].camera, str(folder), "once").frames())
    assert len(frames) == 2
    names = {path.name for path in folder.rglob("*")}
    assert not {name for name in names if "truth" in name or "pose" in name or "traj" in name}


@pytest.mark.parametrize("layout", ("euroc", "replica"))
def test_a_benchmark_is_one_command(tmp_path, layout):
    name = MAKERS[layout](tmp_path / "data", walk(COUNT))
    summary = run(options(layout, tmp_path / "data", name, split=2), tmp_path / "out")
    assert summary["robots_joined"] == 2 and summary["frames_placed"] == COUNT
    assert summary["ate_joint_m"] < 0.03
    written = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert written["ate_joint_m"] == summary["ate_joint_m"]
    assert len(written["published"]) == len(REPORTED[layout])
    tum = tmp_path / "out" / "tum"
    names = [path.stem for path in tum.glob("*.tum") if not path.stem.endswith("_truth")]
    read = {
        robot: (read_tum(tum / f"{robot}_truth.tum")[1], read_tum(tum / f"{robot}.tum")[1])
        for robot in names
    }
    again = trajectory_error({k: (a[:, :3, 3], b[:, :3, 3]) for k, (a, b) in read.items()})
    assert again.joint_m == pytest.approx(summary["ate_joint_m"], abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_one_fit_of_all_robots_sees_what_a_fit_of_each_does_not(seed):
    rng = np.random.default_rng(seed)
    true = {f"r{k}": rng.normal(0, 3, (20, 3)) for k in range(3)}
    T = pose_of(rng.normal(size=4), rng.normal(0, 10, 3))
    moved = {k: p @ T[:3, :3].T + T[:3, 3] for k, p in true.items()}
    exact = trajectory_error({k: (true[k], moved[k]) for k in true})
    assert exact.joint_m == pytest.approx(0, abs=1e-9)
    moved["r1"] = moved["r1"] + (1.0, 0.0, 0.0)
    off = trajectory_error({k: (true[k], moved[k]) for k in true})
    assert max(off.robots_m.values()) == pytest.approx(0, abs=1e-9)
    # a third is 1 m off: without a turn that would be sqrt(1/3 2/3), turning makes it no worse
    assert 0.2 < off.joint_m <= np.sqrt(2) / 3 + 1e-9


def test_too_few_poses_have_no_error():
    two = np.zeros((2, 3))
    assert trajectory_error({"r1": (two, two)}).joint_m is None
    assert trajectory_error({}).robots_mean_m is None


@pytest.mark.parametrize(
    ("layout", "robots", "said"),
    [
        ("s3e", "Alpha", "no bag there"),
        ("graco", "", "name its robots"),
        ("laps", "a", "known are euroc"),
        ("tum", "none", "no folder"),
        ("tum", "fr1,fr1", "each once"),
        ("tum", "", "groundtruth.txt"),
    ],
)
def test_what_cannot_be_played_is_a_sentence(tmp_path, layout, robots, said):
    MAKERS["tum"](tmp_path, walk(1))
    with pytest.raises(DataFolderError, match=said):
        robots_of(options(layout, tmp_path, robots))
    with pytest.raises(DataFolderError, match="smaller --split"):
        robots_of(options("tum", tmp_path, "fr1", split=2))
