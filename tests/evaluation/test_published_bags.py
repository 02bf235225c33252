"""Published benchmarks of bags: their topics by name, their stamps, their truths."""

import json

import numpy as np
import pytest

from fleetpose.evaluation.bench.published.command import robots_of, run
from fleetpose.evaluation.bench.published.truths import read_truth
from fleetpose.evaluation.options.published import BenchOptions
from fleetpose.protocol.errors import CalibrationError, DataFolderError
from tests.evaluation.bag_folders import BAG_MAKERS
from tests.evaluation.folder_makers import walk

COUNT = 4
STAMPS = {"kimera-multi": "receive"}


def made(layout: str, data, **more) -> BenchOptions:
    poses = walk(2 * COUNT)
    data.mkdir()
    robots, calibration = BAG_MAKERS[layout](data, (poses[:COUNT], poses[COUNT:]))
    given = {"every": 1, "calibration": calibration, "stamps": STAMPS.get(layout, "header"), **more}
    return BenchOptions(layout, data, robots, **given)


@pytest.mark.parametrize("layout", BAG_MAKERS)
def test_robots_see_what_was_recorded_where_they_truly_were(tmp_path, layout):
    robots = robots_of(made(layout, tmp_path / "data"))
    shots = [shot for robot in robots for shot in robot.shots]
    assert [len(robot.shots) for robot in robots] == [COUNT, COUNT]
    for shot, T in zip(shots, walk(2 * COUNT), strict=True):
        assert np.allclose(shot.T_world_camera[:3, 3], T[:3, 3], atol=1e-6)
    half = robots[0].every(2)
    stamps_ns = [frame.stamp_ns for frame in half.frames(tmp_path / "robot") if frame]
    assert stamps_ns == [shot.stamp_ns for shot in half.shots] and len(stamps_ns) == COUNT // 2


@pytest.mark.parametrize("layout", BAG_MAKERS)
def test_a_benchmark_of_bags_is_one_command(tmp_path, layout):
    summary = run(made(layout, tmp_path / "data"), tmp_path / "out")
    assert summary["robots_joined"] == 2 and summary["frames_placed"] == 2 * COUNT
    assert summary["ate_joint_m"] < 0.03 and summary["lost"] == 0
    assert set(summary["ate_robots_m"].keys()) == set(summary["frames_of_robots"])
    written = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert "part of the error" in written["truth"] and written["published"]


def test_stamps_of_another_clock_than_the_truths_are_named(tmp_path):
    with pytest.raises(DataFolderError, match="try --stamps receive"):
        robots_of(made("kimera-multi", tmp_path / "data", stamps="header"))


def test_bags_without_infos_ask_for_a_calibration(tmp_path):
    with pytest.raises(CalibrationError, match="--calibration"):
        robots_of(made("s3e", tmp_path / "data", calibration=None))


def test_a_position_between_two_is_told_unless_they_are_far_apart(tmp_path):
    path = tmp_path / "gt.txt"
    path.write_text("# t x y z\n100.0 0 0 0\n101.0 1 2 3\n110.0 5 5 5\n")
    truth = read_truth(path)
    assert np.allclose(truth.at(100_250_000_000)[:3, 3], (0.25, 0.5, 0.75))
    assert np.allclose(truth.at(110_000_000_000)[:3, 3], 5)
    assert all(truth.at(at) is None for at in (105 * 10**9, 99 * 10**9, 111 * 10**9))
    path.write_text("nothing here\n")
    with pytest.raises(DataFolderError, match="time x y z"):
        read_truth(path)
