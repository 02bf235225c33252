"""A reconstruction is a recording like any other, in metres where its scale is told."""

import random

import numpy as np
import pytest
from typer.testing import CliRunner

from fleetpose.evaluation.__main__ import app
from fleetpose.evaluation.data.anonymize import strip
from fleetpose.evaluation.data.opening import median_depth_m, open_recording, points_of
from fleetpose.evaluation.data.reconstructed import in_metres
from fleetpose.evaluation.data.recording import shared_tracks
from fleetpose.protocol.errors import DataFolderError
from tests.evaluation.makers import write_posed_views
from tests.evaluation.test_strip import assert_no_truth
from tests.robot_agent.reconstruction_makers import (
    NAMES,
    WRITERS,
    write_bundler,
    write_colmap_text,
    write_images,
)

COMMANDS = ("pairs", "align", "ring", "clicks", "questions", "wire", "fleet", "restarts", "operate")


@pytest.mark.parametrize("kind", WRITERS)
def test_a_reconstruction_is_a_recording(tmp_path, kind):
    recording = open_recording(WRITERS[kind](tmp_path))
    assert recording.clouds == "sparse" and len(recording.usable) == 3
    a, b = recording.usable[:2]
    assert shared_tracks(recording, a, b) == 29
    uv, p = points_of(a)
    projected = p @ a.K.T
    assert np.allclose(projected[:, :2] / projected[:, 2:], uv, atol=1e-3)
    with pytest.raises(DataFolderError, match="sparse"):
        open_recording(tmp_path, "stereo_dense")


def test_a_scale_makes_clouds_and_poses_metres(tmp_path):
    write_bundler(tmp_path)
    plain, metres = open_recording(tmp_path), open_recording(in_metres(tmp_path, 2.5))
    assert median_depth_m(metres) == pytest.approx(2.5 * median_depth_m(plain))
    for a, b in zip(plain.views, metres.views, strict=True):
        assert np.allclose(b.T_world_camera[:3, 3], 2.5 * a.T_world_camera[:3, 3])
        assert np.allclose(b.T_world_camera[:3, :3], a.T_world_camera[:3, :3])


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_a_scale_of_what_is_in_metres(tmp_path, command):
    write_posed_views(tmp_path / "set")
    given = ["--data", str(tmp_path / "set"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [command, *given, "--metres-per-unit", "2"])
    assert isinstance(result.exception, DataFolderError)
    assert "is no reconstruction" in str(result.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["fleet", "restarts", "operate"])
def test_a_scale_without_data_is_refused(tmp_path, command):
    given = ["--out", str(tmp_path / "out"), "--metres-per-unit", "2"]
    result = CliRunner().invoke(app, [command, *given])
    assert isinstance(result.exception, DataFolderError) and "--data" in str(result.exception)


@pytest.mark.parametrize("scale", [0.0, -1.0, float("nan"), float("inf")])
def test_a_scale_that_cannot_be_is_refused(tmp_path, scale):
    with pytest.raises(DataFolderError, match="above 0"):
        in_metres(write_bundler(tmp_path), scale)


def test_a_stripped_reconstruction_holds_no_truth(tmp_path):
    recording = open_recording(write_bundler(tmp_path))
    folder = strip(recording, recording.views[:2], tmp_path / "agent", random.Random(1))
    assert_no_truth(folder.path, recording)


def test_images_of_one_name_in_two_folders_are_two_views(tmp_path):
    write_colmap_text(tmp_path)
    names = ["a/1.jpg", "b/1.jpg", "b/2.jpg"]
    write_images(tmp_path, names)
    text = (tmp_path / "images.txt").read_text()
    for old, new in zip(NAMES, names, strict=True):
        text = text.replace(old, new)
    (tmp_path / "images.txt").write_text(text)
    assert [view.name for view in open_recording(tmp_path).views] == [
        "a_1.jpg",
        "b_1.jpg",
        "b_2.jpg",
    ]
    (tmp_path / "b" / "1.png").write_bytes((tmp_path / "b" / "1.jpg").read_bytes())
    (tmp_path / "images.txt").write_text(text.replace("a/1.jpg", "b/1.png"))
    (tmp_path / "again").symlink_to(tmp_path)  # another path, since views are written once of each
    with pytest.raises(DataFolderError, match="by their ending only"):
        open_recording(tmp_path / "again")
