"""`pose-deploy` refuses what it cannot run with one sentence."""

import subprocess
import sys

import pytest

from fleetpose.deploy.__main__ import robot_source
from fleetpose.protocol.errors import NameRefusedError


def test_a_robot_is_told_by_name_camera_and_data():
    assert robot_source("r1=rgbd:some/folder") == ("r1", "rgbd", "some/folder")
    assert robot_source("r2=synthetic:127.0.0.1:99/r2") == ("r2", "synthetic", "127.0.0.1:99/r2")


@pytest.mark.parametrize(
    "text", ["r1", "r1=rgbd", "r1:rgbd=x", "R 1=rgbd:x", "=rgbd:x", "r1=rgbd:"]
)
def test_another_form_is_refused(text):
    with pytest.raises(NameRefusedError):
        robot_source(text)


def test_a_wrong_robot_ends_with_one_sentence_and_code_2():
    done = subprocess.run(
        [sys.executable, "-P", "-m", "fleetpose.deploy", "local", "--robots", "r1"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.returncode == 2
    assert "NAME=CAMERA:DATA" in done.stderr
    assert "Traceback" not in done.stderr
