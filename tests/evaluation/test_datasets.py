"""Recordings are read as data/README.md says; truth comes out as T_world_camera."""

import json

import numpy as np
import pytest

from fleetpose.evaluation.data.opening import median_depth_m, open_recording, points_of
from fleetpose.evaluation.data.recording import are_partners, in_ring_order, shared_tracks
from fleetpose.evaluation.data.rgbd import read_depth
from fleetpose.protocol.errors import DataFolderError
from tests.data import shared_data
from tests.evaluation.makers import K, write_posed_views, write_rgbd


def test_posed_views_give_back_their_poses_and_cameras(tmp_path):
    poses = write_posed_views(tmp_path / "set")
    recording = open_recording(tmp_path / "set", "sparse")
    names = [view.name for view in recording.views]
    assert names == ["photo00.png", "photo01.png", "photo02.png", "photo03.png"]
    indices = [view.index for view in recording.views]
    assert indices == [0, 1, 2, 3]
    for view, T_world_camera in zip(recording.views, poses, strict=True):
        assert view.T_world_camera == pytest.approx(T_world_camera, abs=1e-9)
        assert np.array_equal(view.K, K)
    assert not recording.is_rgbd


def test_points_agree_with_pose_and_pixel(tmp_path):
    write_posed_views(tmp_path / "set")
    view = open_recording(tmp_path / "set", "sparse").views[1]
    uv, xyz = points_of(view)
    projected = xyz @ view.K.T
    assert projected[:, :2] / projected[:, 2:] == pytest.approx(uv, abs=1e-6)


def test_a_view_without_a_cloud_is_left_out_and_the_others_keep_their_index(tmp_path):
    write_posed_views(tmp_path / "set")
    (tmp_path / "set" / "sparse" / "photo01.npz").unlink()
    recording = open_recording(tmp_path / "set", "sparse")
    assert [view.index for view in recording.usable] == [0, 2, 3]
    assert len(recording.views) == 4


def test_shared_counts_track_ids_of_sparse_whatever_the_clouds(tmp_path):
    write_posed_views(tmp_path / "set", points=300)
    for clouds in ("sparse", "sparse_noisy", "stereo_pair_sparse"):
        recording = open_recording(tmp_path / "set", clouds)
        assert shared_tracks(recording, recording.views[1], recording.views[3]) == 240


def test_partners_are_known_for_stereo_clouds_only(tmp_path):
    write_posed_views(tmp_path / "set")
    stereo = open_recording(tmp_path / "set", "stereo_pair_sparse").views
    assert are_partners(stereo[0], stereo[1])
    assert not are_partners(stereo[1], stereo[2])
    assert stereo[0].baseline_m == 0.25
    sparse = open_recording(tmp_path / "set", "sparse").views
    assert not are_partners(sparse[0], sparse[1])


def test_ring_order_is_by_angle_not_by_name(tmp_path):
    write_posed_views(tmp_path / "set")
    content = json.loads((tmp_path / "set" / "cameras.json").read_text())
    for camera, angle in zip(content["cameras"], (30, 10, 20, 0), strict=True):
        camera["ring_angle_deg"] = angle
    (tmp_path / "set" / "cameras.json").write_text(json.dumps(content))
    recording = open_recording(tmp_path / "set", "sparse")
    assert [view.index for view in in_ring_order(recording.views)] == [3, 1, 2, 0]


def test_rgbd_frames_give_back_poses_even_if_recorded_badly(tmp_path):
    poses = write_rgbd(tmp_path / "set", wrong_scale=1.01)
    recording = open_recording(tmp_path / "set")
    assert recording.is_rgbd
    assert [view.name for view in recording.views][:2] == ["frame-000000", "frame-000010"]
    for view, T_world_camera in zip(recording.views, poses, strict=True):
        assert view.T_world_camera == pytest.approx(T_world_camera, abs=1e-9)
    assert median_depth_m(recording) == pytest.approx(2.0, abs=0.01)


def test_depth_is_in_metres_with_nan_where_there_is_none(tmp_path):
    write_rgbd(tmp_path / "set", count=1)
    depth = read_depth(tmp_path / "set" / "frame-000000.depth.png")
    assert np.isnan(depth[:10]).all()
    assert 1.98 < depth[10:].min() <= depth[10:].max() < 2.02


def test_frames_whose_tracking_was_lost_are_left_out(tmp_path):
    write_rgbd(tmp_path / "set")
    np.savetxt(tmp_path / "set" / "frame-000010.pose.txt", np.full((4, 4), np.nan))
    assert [view.index for view in open_recording(tmp_path / "set").views] == [0, 2, 3]


def test_a_folder_that_is_no_recording_is_refused_with_a_sentence(tmp_path):
    with pytest.raises(DataFolderError, match=r"neither cameras\.json .* nor"):
        open_recording(tmp_path)


def test_clouds_that_are_not_there_are_refused_and_those_there_named(tmp_path):
    write_posed_views(tmp_path / "set")
    with pytest.raises(DataFolderError, match=r"stereo_dense.*sparse, sparse_noisy"):
        open_recording(tmp_path / "set", "stereo_dense")


def test_the_only_clouds_there_need_no_name(tmp_path):
    write_posed_views(tmp_path / "set")
    assert open_recording(tmp_path / "set").clouds == "sparse_noisy"
    for kind in ("sparse_noisy", "stereo_pair_sparse"):
        (tmp_path / "set" / kind).rename(tmp_path / kind)
    assert open_recording(tmp_path / "set").clouds == "sparse"


def test_clouds_of_an_rgbd_folder_cannot_be_chosen(tmp_path):
    write_rgbd(tmp_path / "set")
    with pytest.raises(DataFolderError, match="leave --clouds out"):
        open_recording(tmp_path / "set", "sparse")


def test_a_camera_without_pose_is_refused(tmp_path):
    write_posed_views(tmp_path / "set")
    content = json.loads((tmp_path / "set" / "cameras.json").read_text())
    del content["cameras"][2]["R_world_to_cam"]
    (tmp_path / "set" / "cameras.json").write_text(json.dumps(content))
    with pytest.raises(DataFolderError, match="R_world_to_cam"):
        open_recording(tmp_path / "set", "sparse")


def test_recorded_tracks_meet_where_the_true_poses_say():
    recording = open_recording(shared_data("church_herzjesu"), "sparse")
    i, j = recording.views[3], recording.views[5]
    tracks_i, tracks_j = recording.tracks(i), recording.tracks(j)
    assert tracks_i is not None
    assert tracks_j is not None
    _, at_i, at_j = np.intersect1d(tracks_i[0], tracks_j[0], return_indices=True)
    T_j_i = np.linalg.inv(j.T_world_camera) @ i.T_world_camera
    moved = points_of(i)[1][at_i] @ T_j_i[:3, :3].T + T_j_i[:3, 3]
    projected = (moved @ j.K.T)[:, :2] / moved[:, 2:]
    assert np.median(np.linalg.norm(projected - tracks_j[1][at_j], axis=1)) < 1.0
