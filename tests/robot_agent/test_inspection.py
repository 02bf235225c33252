"""What `robot-agent inspect` says of what people have."""

import json

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from fleetpose.robot_agent.__main__ import app
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig, content_of

SIZE = (320, 240)
K = np.array([[266.0, 0, 159.5], [0, 266.0, 119.5], [0, 0, 1]])
T = np.eye(4)
T[0, 3] = -0.12
RIG = StereoRig(K, np.zeros(5), K, np.zeros(5), T, SIZE)


@pytest.fixture
def inspected():
    def run(*arguments):
        done = CliRunner().invoke(app, ["inspect", *map(str, arguments)])
        return done.output if done.exception is None else str(done.exception)

    return run


@pytest.fixture
def stereo(tmp_path):
    """A textured wall 2.66 m away: 12 px between both eyes."""
    rng = np.random.default_rng(3)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (240, 340, 3), np.uint8), (0, 0), 1.2)
    for side, from_px in (("left", 0), ("right", 12)):
        (tmp_path / side).mkdir()
        cv2.imwrite(str(tmp_path / side / "0.png"), wall[:, from_px : from_px + 320])
    (tmp_path / "stereo.json").write_text(json.dumps(content_of(RIG)))
    return tmp_path


def test_a_stereo_folder_is_told_with_its_numbers_and_its_command(inspected, stereo):
    said = inspected(stereo)
    assert "is a stereo camera" in said
    assert "320x240 px, f 266 px = 62 deg wide, baseline 0.12 m, depths 2.7 to 2.7 m" in said
    assert f"robot-agent run --name r1 --camera stereo --data {stereo}" in said


def test_eyes_that_changed_places_are_named(inspected, stereo):
    (stereo / "left").rename(stereo / "other")
    (stereo / "right").rename(stereo / "left")
    (stereo / "other").rename(stereo / "right")
    assert "exchange the left and the right images" in inspected(stereo)


def test_an_rgbd_folder_is_told_with_what_is_odd(inspected, tmp_path):
    for kind in ("rgb", "depth"):
        (tmp_path / kind).mkdir()
    for n in (1, 2, 10):
        cv2.imwrite(str(tmp_path / f"rgb/{n}.jpg"), np.full((480, 640, 3), 99, np.uint8))
    for n in (1, 10):
        depth = np.full((480, 640), 2000, np.uint16)
        cv2.imwrite(str(tmp_path / f"depth/{n}.png"), depth)
    (tmp_path / "camera.yaml").write_text("Camera.fx: 500.0\nCamera.fy: 500.0\nCamera.cx: 319.5\n")
    assert "has no fx, fy, cx and cy" in inspected(tmp_path)
    with (tmp_path / "camera.yaml").open("a") as file:
        file.write("Camera.cy: 239.5\nDepthMapFactor: 1000.0\n")
    said = inspected(tmp_path)
    assert "is an RGB-D recording" in said and "100% of the pixels have depth" in said
    assert "1 of 3 colour images have no partner" in said and "2.jpg" in said
    assert "warning" in said  # a picture of one colour has no keypoints


def test_what_is_nothing_is_told_by_kind(inspected, tmp_path):
    said = inspected(tmp_path)
    assert "of no kind that is known" in said
    assert all(f"{kind}: " in said for kind in ("stereo", "rgbd", "views", "cloud"))
