"""`pose-eval synth` writes posed views whose truth is exact and whose noise is as stated."""

import random

import numpy as np
import pytest

from fleetpose.evaluation.bench.ring.layout import rings_of
from fleetpose.evaluation.bench.synth import SynthOptions, run
from fleetpose.evaluation.data.anonymize import noise_model, strip
from fleetpose.evaluation.data.opening import open_recording, points_of
from fleetpose.evaluation.data.recording import CLOUD_KINDS, in_ring_order, shared_tracks
from fleetpose.evaluation.metrics.geometry import transform
from fleetpose.protocol.errors import FleetPoseError
from tests.evaluation.test_strip import assert_no_truth


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("synth") / "ring"
    run(SynthOptions(robots=8, workers=1), out)
    return out


def test_robots_stand_at_exactly_equal_angles_and_look_at_common_points(folder):
    recording = open_recording(folder, "stereo_dense")
    views = in_ring_order(recording.usable)
    angles = np.array([view.ring_angle_deg for view in views])
    assert np.allclose(np.diff(angles), 45.0, atol=1e-9)
    ((ring,),) = rings_of(recording)
    assert ring.separation_deg == pytest.approx(45.0)
    assert len(ring.pairs) == 8
    assert min(shared_tracks(recording, i, j) or 0 for i, j in ring.pairs) > 300


def test_common_points_are_the_same_place_in_every_view(folder):
    recording = open_recording(folder, "sparse")
    places = {}
    for view in recording.usable:
        uv, xyz = points_of(view)
        projected = (xyz @ view.K.T)[:, :2] / xyz[:, 2:]
        assert np.abs(projected - uv).max() < 1e-3
        ids, _ = recording.tracks(view)
        for track, place in zip(ids[::20], transform(view.T_world_camera, xyz)[::20], strict=True):
            assert np.allclose(places.setdefault(track, place), place, atol=1e-4)
    assert len(places) > 300


def test_noise_is_as_stated(folder):
    exact, noisy = (open_recording(folder, kind) for kind in ("sparse", "sparse_noisy"))
    for true, measured in zip(exact.usable[:2], noisy.usable[:2], strict=True):
        (uv, xyz), (noisy_uv, noisy_xyz) = points_of(true), points_of(measured)
        with np.load(measured.cloud) as arrays:
            errors = (noisy_xyz[:, 2] - xyz[:, 2]) / arrays["sigma_z"]
        assert errors.std() == pytest.approx(1.0, abs=0.1)
        assert (noisy_uv - uv).std() == pytest.approx(0.7, abs=0.05)
        assert noise_model("sparse_noisy", measured)["pixel_sigma_px"] == 0.7


def test_every_kind_of_cloud_can_be_stripped_and_no_truth_is_left(folder, tmp_path):
    for kind in CLOUD_KINDS:
        recording = open_recording(folder, kind)
        assert all(view.partner is None for view in recording.usable)
        stripped = strip(recording, recording.usable[:2], tmp_path / kind, random.Random(0))
        assert_no_truth(stripped.path, recording)


def test_a_folder_with_views_is_not_overwritten(folder):
    with pytest.raises(FleetPoseError, match="new folder"):
        run(SynthOptions(robots=8), folder)
