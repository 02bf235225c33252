"""No truth is readable in what an agent is given."""

import json
import random
import re

import numpy as np
import pytest

from fleetpose.evaluation.data.anonymize import noise_model, random_name, strip
from fleetpose.evaluation.data.opening import open_recording
from fleetpose.protocol.errors import DataFolderError
from fleetpose.protocol.keys import checked_name
from fleetpose.protocol.messages import NoiseModel
from tests.data import shared_data
from tests.evaluation.makers import write_posed_views, write_rgbd

TRUTH_WORDS = (
    b"world", b"pose", b"R_", b"center", b"track", b"ring_angle", b"partner", b"baseline_m",
)  # fmt: skip


def all_bytes(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_no_truth(folder, recording):
    files = all_bytes(folder)
    numbers = {
        f"{abs(value):.5f}".encode()
        for view in recording.views
        for value in (*view.T_world_camera[:3, :3].ravel(), *view.T_world_camera[:3, 3])
        if 0.01 < abs(value) < 0.99
    }
    for path, content in files.items():
        named = str(path.relative_to(folder)).encode()
        if not recording.is_rgbd:  # its frames are numbered anew, from 0 on
            for view in recording.views:
                assert view.name.encode() not in content
                assert view.image.stem.encode() not in named
        if path.suffix in (".json", ".txt"):
            assert not any(word in content for word in TRUTH_WORDS), path
            assert not any(number in content for number in numbers), path
        assert not path.is_symlink()
        assert "pose" not in path.name
    for path in folder.rglob("*.npz"):
        with np.load(path) as arrays:
            assert set(arrays) == {"uv", "xyz_cam"}


@pytest.mark.parametrize("clouds", ["sparse", "sparse_noisy", "stereo_pair_sparse"])
def test_a_stripped_posed_view_holds_no_truth(tmp_path, clouds):
    write_posed_views(tmp_path / "set")
    recording = open_recording(tmp_path / "set", clouds)
    folder = strip(recording, recording.views[:3], tmp_path / "agent", random.Random(1))
    assert_no_truth(folder.path, recording)
    cameras = json.loads((folder.path / "cameras.json").read_text())["cameras"]
    assert {frozenset(camera) for camera in cameras} == {
        frozenset({"name", "width", "height", "K", "noise"})
    }
    assert {path.name for path in folder.path.iterdir()} == {"cameras.json", "images", "clouds"}


def test_a_stripped_rgbd_stretch_holds_no_truth_and_no_place_in_the_walk(tmp_path):
    write_rgbd(tmp_path / "set")
    recording = open_recording(tmp_path / "set")
    folder = strip(recording, recording.views[2:], tmp_path / "agent", random.Random(1))
    assert_no_truth(folder.path, recording)
    assert sorted(path.name for path in folder.path.iterdir()) == [
        "camera-intrinsics.txt",
        "frame-000000.color_registered.jpg",
        "frame-000000.depth.png",
        "frame-000001.color_registered.jpg",
        "frame-000001.depth.png",
    ]
    given = (folder.path / "frame-000000.depth.png").read_bytes()
    assert given == (tmp_path / "set" / "frame-000020.depth.png").read_bytes()


@pytest.mark.parametrize("name", ["church_herzjesu", "ring_temple", "rgbd_7scenes_redkitchen_A"])
def test_recorded_data_is_stripped_of_its_truth(tmp_path, name):
    recording = open_recording(shared_data(name))
    folder = strip(recording, recording.views[5:8], tmp_path / "agent", random.Random(1))
    assert_no_truth(folder.path, recording)


def test_views_keep_their_order_under_random_names(tmp_path):
    write_posed_views(tmp_path / "set")
    recording = open_recording(tmp_path / "set", "sparse")
    chosen = [recording.views[k] for k in (2, 0, 3)]
    folder = strip(recording, chosen, tmp_path / "agent", random.Random(1))
    cameras = json.loads((folder.path / "cameras.json").read_text())["cameras"]
    names = [camera["name"] for camera in cameras]
    assert names == sorted(names)
    for name, view in zip(names, chosen, strict=True):
        given = (folder.path / "images" / name).read_bytes()
        assert given == view.image.read_bytes()


def test_names_differ_from_run_to_run_and_may_be_chunks_of_keys():
    names = {random_name(random.Random(seed)) for seed in range(50)}
    assert len(names) == 50
    assert all(re.fullmatch(r"r[a-z0-9]{5}", checked_name(name)) for name in names)


def test_noise_follows_the_kind_of_clouds(tmp_path):
    write_posed_views(tmp_path / "set")

    def noise(clouds):
        view = open_recording(tmp_path / "set", clouds).views[0]
        return NoiseModel.model_validate(noise_model(clouds, view))

    assert noise("sparse").depth_sigma_m == (0.0, 0.003, 0.0)
    noisy = noise("sparse_noisy")
    assert noisy.pixel_sigma_px == 0.7
    assert noisy.depth_sigma_m == pytest.approx((0.0, 0.0, 0.01))
    stereo = noise("stereo_pair_sparse")
    assert stereo.focal_baseline_px_m == pytest.approx(200.0 * 0.25)
    assert stereo.depth_sigma_m == pytest.approx((0.0, 0.0, 0.7 / 50.0))


def test_stereo_clouds_without_a_baseline_are_refused(tmp_path):
    write_posed_views(tmp_path / "set", partners=False)
    recording = open_recording(tmp_path / "set", "stereo_pair_sparse")
    with pytest.raises(DataFolderError, match="baseline"):
        strip(recording, recording.views[:1], tmp_path / "agent", random.Random(1))


def test_a_missing_image_is_told(tmp_path):
    write_posed_views(tmp_path / "set")
    (tmp_path / "set" / "images" / "photo00.png").unlink()
    recording = open_recording(tmp_path / "set", "sparse")
    with pytest.raises(DataFolderError, match=r"photo00\.png"):
        strip(recording, recording.views[:1], tmp_path / "agent", random.Random(1))


def test_the_robots_own_camera_reads_a_stripped_folder(tmp_path):
    from fleetpose.robot_agent.cameras.factory import open_camera

    write_posed_views(tmp_path / "views")
    write_rgbd(tmp_path / "rgbd")
    for name, clouds in (("views", "sparse_noisy"), ("rgbd", None)):
        recording = open_recording(tmp_path / name, clouds)
        folder = strip(recording, recording.views[:2], tmp_path / f"agent-{name}", random.Random(1))
        frames = list(open_camera(folder.camera, str(folder.path), "once").frames())
        assert len(frames) == 2
        assert frames[0].image.shape == (120, 160, 3)
