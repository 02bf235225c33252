"""The truth of the synthetic world is read from what its process writes, by robot and moment."""

import json
from pathlib import Path

import numpy as np
import pytest

from fleetpose.evaluation.system.observer import SeenView
from fleetpose.evaluation.system.truth import WorldTruth
from tests.evaluation.makers import pose
from tests.evaluation.test_live import view

FIRST = {"r1": pose(10.0, (1.0, 0.0, 0.0)), "r2": pose(20.0, (0.0, 1.0, 0.0))}


@pytest.fixture
def truth_file(tmp_path) -> Path:
    file = tmp_path / "truth"
    poses = {name: T.tolist() for name, T in FIRST.items()}
    file.write_text(json.dumps({"radius_m": 10.0, "T_world_robots": poses}))
    return file


@pytest.fixture
def truth(truth_file) -> WorldTruth:
    return WorldTruth(truth_file, {"rabc": "r2", "rxyz": "r1"})


def seen(robot: str, depth_m: float = 2.0) -> SeenView:
    return SeenView(view(robot, 0, depth_m), "digest", 0.0, 0)


def test_a_still_robot_is_where_its_place_is_whatever_its_name(truth):
    assert truth.T_world_robot(seen("rabc")) == pytest.approx(FIRST["r2"])
    assert truth.T_world_robot(seen("rxyz")) == pytest.approx(FIRST["r1"])
    assert truth.T_world_robot(seen("stranger")) is None
    assert truth.radius_m() == 10.0


def test_a_moving_robot_is_where_it_was_at_the_stamp_of_its_view(truth, truth_file):
    first, second = seen("rabc"), seen("rabc")
    log = Path(f"{truth_file}.log.jsonl")

    def line(one: SeenView, T) -> str:
        entry = {"robot": "r2", "stamp_ns": one.view.stamp_ns, "T_world_robot": T.tolist()}
        return json.dumps(entry) + "\n"

    half_written = line(second, pose(2.0))
    log.write_text(line(first, pose(1.0)) + half_written[:30])
    assert truth.T_world_robot(first) == pytest.approx(pose(1.0))
    assert truth.T_world_robot(second) is None
    log.write_text(line(first, pose(1.0)) + half_written)
    assert truth.T_world_robot(second) == pytest.approx(pose(2.0))
    assert truth.T_world_robot(first) == pytest.approx(pose(1.0))


def test_median_depth_is_of_the_clouds_that_were_seen(truth):
    views = [seen("rabc", 2.0), seen("rabc", 2.0), seen("rxyz", 5.0)]
    assert truth.median_depth_m(views) == pytest.approx(2.0, abs=0.001)
    assert np.isnan(truth.median_depth_m([]))


def test_the_operator_sees_what_two_robots_have_in_common(truth_file):
    at_once = {"r1": np.eye(4).tolist(), "r2": pose(0.0, (0.2, 0.0, 0.0)).tolist()}
    truth_file.write_text(json.dumps({"radius_m": 10.0, "T_world_robots": at_once}))
    truth = WorldTruth(truth_file, {"ra": "r1", "rb": "r2"})
    uv_i, uv_j = truth.correspondences(seen("ra"), seen("rb"))
    assert len(uv_i) > 1000
    # 20 cm to the right, 2 m away, 200 px focal length
    assert uv_j - uv_i == pytest.approx(np.tile([-20.0, 0.0], (len(uv_i), 1)), abs=0.01)
