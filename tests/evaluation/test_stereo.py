"""The stereo video of the synthetic world: its depth, and calibrations good and bad."""

import json

import numpy as np
import pytest

from fleetpose.evaluation.bench.stereo import calibrations, checked, depth_errors
from fleetpose.evaluation.simulate.stereo_video import lens_rig, make_video
from fleetpose.robot_agent.cameras.stereo.rig import content_of

CASES = list(calibrations(lens_rig(10.0)))


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    return make_video(tmp_path_factory.mktemp("video") / "stereo.mkv", stations=3)


def test_depth_of_a_video_is_right_to_one_percent_at_the_rings_distance(video, tmp_path):
    calibration = tmp_path / "stereo.json"
    calibration.write_text(json.dumps(content_of(video.rig)))
    rows = list(depth_errors(video, calibration))
    assert {row["station"] for row in rows} == {0, 1, 2}
    assert max(row["error_median"] for row in rows) < 0.01
    assert max(row["error_ring_median"] for row in rows) < 0.01
    assert np.median([row["coverage"] for row in rows]) > 0.5


@pytest.mark.parametrize(("name", "rig", "expects"), CASES, ids=[case[0] for case in CASES])
def test_a_calibration_is_named_for_what_it_is(video, tmp_path, name, rig, expects):
    check = checked(name, rig, expects, video, tmp_path)
    assert check["named"], check["sentence"]
    assert check["exit_code"] == (1 if expects else 0)
