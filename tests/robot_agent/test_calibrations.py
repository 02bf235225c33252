"""One rig in the files of many tools: each is read as the same rig, or refused by its name."""

import json

import numpy as np
import pytest

from fleetpose.evaluation.bench.cameras.calibrations import FILES, outcome_of
from fleetpose.evaluation.bench.cameras.made.known import SIZE, T_RIGHT_LEFT
from fleetpose.evaluation.bench.cameras.made.known import written as text
from fleetpose.evaluation.bench.cameras.made.plain import opencv_fisheye, ours
from fleetpose.protocol.errors import CalibrationError
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig, read_rig_file


@pytest.mark.parametrize("expected", FILES, ids=lambda one: one.write.__name__)
def test_a_rig_is_the_same_from_the_files_of_every_tool(expected, tmp_path):
    says, is_right = outcome_of(expected, expected.write(tmp_path))
    assert is_right, says


def test_four_numbers_that_may_be_either_lens_are_refused(tmp_path):
    content = json.loads(opencv_fisheye(tmp_path).read_text())
    del content["model"]
    content |= {"D1": [-0.03, 0.02, 0.001, 0.0001], "D2": [-0.03, 0.02, 0.001, 0.0]}
    with pytest.raises(CalibrationError, match=r"4 numbers .*distortion_model"):
        read_rig_file(text(tmp_path / "stereo.json", content), SIZE)
    content["distortion_model"] = "radtan"
    assert read_rig_file(text(tmp_path / "stereo.json", content), SIZE).lens == "normal"


@pytest.mark.parametrize("unit", [0.001, 0.01, 0.0333])
def test_a_translation_in_another_unit_is_asked_for_and_told(unit, tmp_path):
    content = json.loads(ours(tmp_path).read_text())
    content["t"] = (T_RIGHT_LEFT[:3, 3] / unit).tolist()
    path = text(tmp_path / "stereo.json", content)
    with pytest.raises(CalibrationError, match="--translation-unit"):
        read_rig(tmp_path, SIZE)
    np.testing.assert_allclose(
        read_rig_file(path, SIZE, unit).T_right_left, T_RIGHT_LEFT, atol=1e-9
    )


def test_rectified_images_of_data_sets(tmp_path):
    P = "7e+02 0 6e+02 {} 0 7e+02 1.8e+02 0 0 0 1 0"
    lines = [f"P{k}: {P.format(x)}" for k, x in enumerate((0, -378.0, 35.0, -343.0))]
    kitti = read_rig_file(text(tmp_path / "calib.txt", "\n".join(lines)), (1241, 376))
    assert kitti.is_rectified and kitti.baseline_m == pytest.approx(0.54)
    lines = ["cam0=[1000 0 700; 0 1000 500; 0 0 1]", "cam1=[1000 0 730; 0 1000 500; 0 0 1]"]
    lines += ["doffs=30", "baseline=200", "width=1400", "height=1000"]
    middlebury = read_rig_file(text(tmp_path / "m.txt", "\n".join(lines)))
    assert middlebury.size == (1400, 1000) and middlebury.baseline_m == pytest.approx(0.2)
    assert middlebury.K_right[0, 2] - middlebury.K_left[0, 2] == 30


def test_a_zed_has_its_rig_at_the_size_of_the_images(tmp_path):
    sections = ""
    for mode, scale in (("HD", 2), ("VGA", 1)):
        for side in ("LEFT", "RIGHT"):
            sections += f"[{side}_CAM_{mode}]\nfx={350 * scale}\nfy={350 * scale}\n"
            sections += f"cx={336 * scale}\ncy={188 * scale}\nk1=-0.17\nk2=0.02\n"
    sections += "[STEREO]\nBaseline=120\nTY=0.1\nTZ=-0.2\nRX_VGA=0.001\nCV_VGA=0.002\nRZ_VGA=0\n"
    path = text(tmp_path / "SN1234.conf", sections)
    rig = read_rig(tmp_path, (672, 376))
    assert rig.K_left[0, 0] == 350 and rig.D_left[0] == -0.17
    assert rig.T_right_left[0, 3] == -0.12
    with pytest.raises(CalibrationError, match=r"ZED.*1280x720, 672x376"):
        read_rig_file(path, (640, 480))


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        (
            "left.yaml",
            {"camera_matrix": {}, "projection_matrix": {}},
            "ROS camera_info.*right.yaml",
        ),
        ("c.yaml", {"model_type": "MEI", "projection_parameters": {}}, "camodocal"),
        ("rs.json", {"device": {}, "streams": []}, "RealSense"),
        ("oak.json", {"cameraData": [], "stereoRectificationData": {}}, "OAK"),
        ("orb.yaml", {"LEFT.K": [1], "Camera.fx": 1}, "ORB-SLAM2"),
        ("b.json", {"value0": {"T_imu_cam": [], "intrinsics": []}}, "Basalt"),
        ("what.json", {"hello": 1}, "no calibration of a known tool"),
    ],
)
def test_what_is_not_whole_is_refused_by_its_tools_name(name, content, says, tmp_path):
    with pytest.raises(CalibrationError, match=says):
        read_rig_file(text(tmp_path / name, content), SIZE)
