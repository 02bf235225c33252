"""Reconstructions are read as they are, whoever wrote them, and what is wrong is a sentence."""

import struct

import cv2
import numpy as np
import pytest

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.reconstructions.reading import read_reconstruction
from tests.data import shared_data
from tests.robot_agent.reconstruction_makers import (
    COLOUR,
    NAMES,
    SCENE,
    UNSEEN,
    WRITERS,
    measured_by_visualsfm,
    nvm_text,
    write_bundler,
    write_colmap,
    write_colmap_text,
    write_images,
    write_nvm,
)


@pytest.fixture(params=WRITERS)
def kind(request) -> str:
    return request.param


def test_all_kinds_give_the_true_cameras_points_and_pixels(tmp_path, kind):
    found = read_reconstruction(WRITERS[kind](tmp_path))
    assert [view.name for view in found.views] == NAMES
    assert np.allclose(found.points, SCENE.points) and (found.colours == COLOUR).all()
    middle = (np.array(SCENE.size) - 1) / 2
    for k, view in enumerate(found.views):
        R, t = SCENE.pose(k)
        assert np.allclose(view.T_camera_world[:3], np.column_stack((R, t)))
        assert np.allclose(view.K[[0, 1], [0, 1]], SCENE.focal_px)
        assert np.allclose(view.K[:2, 2], middle)
        assert view.seen.tolist() == [n for n in range(len(SCENE.points)) if n != UNSEEN]
        assert np.abs(view.uv - (SCENE.focal_px * SCENE.rays(k) + middle)[view.seen]).max() < 1e-4
    assert len(found.reprojection_px) == 87 and found.reprojection_px.max() < 1e-4


def test_the_image_is_undistorted_as_its_pixels_are(tmp_path, kind):
    found = read_reconstruction(WRITERS[kind](tmp_path))
    for k, view in enumerate(found.views):
        rays = np.column_stack((SCENE.rays(k), np.ones(len(SCENE.points))))
        pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), view.K, view.distortion)
        measured = measured_by_visualsfm(k) if kind == "nvm" else SCENE.distorted(k)
        assert np.abs(pixels[:, 0] - view.K[:2, 2] - measured).max() < 1e-4
        assert view.picture().shape == (*SCENE.size[::-1], 3)


def test_images_lie_as_their_pixels_do_whatever_they_say_of_up(tmp_path):
    """These programs do not turn images either."""
    write_bundler(tmp_path)
    turned = b"Exif\0\0II*\0\x08\0\0\0\x01\0" + struct.pack("<HHIII", 0x0112, 3, 1, 6, 0)
    for name in NAMES:
        jpeg = (tmp_path / name).read_bytes()
        segment = b"\xff\xe1" + struct.pack(">H", len(turned) + 2) + turned
        (tmp_path / name).write_bytes(jpeg[:2] + segment + jpeg[2:])
    assert cv2.imread(str(tmp_path / NAMES[0])).shape[:2] == SCENE.size  # it does say so
    view = read_reconstruction(tmp_path).views[0]
    assert (view.width, view.height) == SCENE.size
    assert view.picture().shape[:2] == SCENE.size[::-1]


def test_metres_per_unit_scale_points_and_poses_alike(tmp_path, kind):
    found = read_reconstruction(WRITERS[kind](tmp_path))
    metres = found.scaled(12.5)
    assert np.allclose(metres.in_camera(metres.views[1]), 12.5 * found.in_camera(found.views[1]))
    assert np.allclose(metres.reprojection_px, found.reprojection_px)


def test_an_agent_takes_one_photo_in_metres_and_hears_nothing_of_poses(tmp_path, kind):
    folder = WRITERS[kind](tmp_path)
    for word in ("reconstruction", "bundler"):
        camera = open_camera(word, str(folder), "once", view="photo1", metres_per_unit=2)
        (frame,) = camera.frames()
        model = read_reconstruction(folder)
        assert np.allclose(frame.ranges.z, 2 * model.in_camera(model.views[1])[:, 2])
        assert np.allclose(frame.model.K, model.views[1].K)
        assert not any("world" in name for name in vars(frame))
        with pytest.raises(DataFolderError, match="photo9"):
            open_camera(word, str(folder), "once", view="photo9")


def test_an_agent_measures_only_what_is_in_the_image(tmp_path):
    """What undistortion moves beyond the border is still there in the file."""
    write_colmap_text(tmp_path)
    write_images(tmp_path, size=(200, 240))
    (tmp_path / "cameras.txt").write_text("4 PINHOLE 200 240 500 500 160 120\n")
    (frame,) = open_camera("reconstruction", str(tmp_path), "once", view="photo0").frames()
    (view,) = read_reconstruction(tmp_path, "photo0").views
    assert len(frame.ranges.uv) == (view.uv[:, 0] < 199.5).sum() < len(view.uv)


@pytest.mark.parametrize("inside", ["", "sparse/0", "sparse", "dense/sparse"])
@pytest.mark.parametrize("images", ["images", ""])
def test_colmaps_folders_are_found_as_it_leaves_them(tmp_path, inside, images):
    write_colmap_text(tmp_path / inside)
    write_images(tmp_path / images)
    for path in (tmp_path, tmp_path / inside, tmp_path / inside / "cameras.txt"):
        found = read_reconstruction(path)
        assert [view.image.parent.resolve() for view in found.views] == 3 * [tmp_path / images]


def test_images_of_a_dense_model_come_before_those_it_was_made_of(tmp_path):
    write_colmap(tmp_path, inside="dense/sparse")
    write_images(tmp_path / "dense" / "images")
    for path in (tmp_path, tmp_path / "dense", tmp_path / "dense" / "sparse"):
        assert read_reconstruction(path).views[0].image.parent == tmp_path / "dense" / "images"


@pytest.mark.parametrize("model", ["RADIAL", "OPENCV", "FULL_OPENCV"])
def test_colmaps_camera_models_are_opencvs(tmp_path, model):
    write_colmap_text(tmp_path, model)
    write_images(tmp_path)
    assert read_reconstruction(tmp_path).reprojection_px.max() < 1e-4


@pytest.mark.parametrize(
    ("parameters", "distortion"),
    [("SIMPLE_PINHOLE 320 240 500 161 121", [0, 0]), ("PINHOLE 320 240 500 500 161 121", [0, 0]),
     ("SIMPLE_RADIAL 320 240 500 161 121 -0.1", [-0.1, 0])],
)  # fmt: skip
def test_colmaps_simple_camera_models_and_its_half_pixel(tmp_path, parameters, distortion):
    write_colmap_text(tmp_path)
    write_images(tmp_path)
    (tmp_path / "cameras.txt").write_text(f"4 {parameters}\n")
    view = read_reconstruction(tmp_path).views[0]
    assert view.K.tolist() == [[500, 0, 160.5], [0, 500, 120.5], [0, 0, 1]]
    assert view.distortion.tolist() == [*distortion, 0, 0]


@pytest.mark.parametrize("number", [5, 77])
def test_a_camera_model_that_cannot_be_undistorted_is_named(tmp_path, number):
    write_colmap(tmp_path, binary=True)
    cameras = tmp_path / "sparse" / "0" / "cameras.bin"
    content = bytearray(cameras.read_bytes())
    content[12:16] = number.to_bytes(4, "little")
    cameras.write_bytes(content)
    named = {5: "OPENCV_FISHEYE", 77: "number 77"}[number]
    with pytest.raises(DataFolderError, match=f"{named}.*colmap image_undistorter"):
        read_reconstruction(tmp_path)
    write_colmap_text(tmp_path)
    (tmp_path / "cameras.txt").write_text("4 OPENCV_FISHEYE 320 240 500 500 160 120 0 0 0 0\n")
    with pytest.raises(DataFolderError, match=r"OPENCV_FISHEYE.*colmap image_undistorter"):
        read_reconstruction(tmp_path / "cameras.txt")


def test_colmaps_image_names_may_have_blanks_and_folders(tmp_path):
    write_colmap_text(tmp_path)
    names = ["left eye/1.jpg", "right eye/1.jpg", "a  b.jpg"]
    write_images(tmp_path / "images", names)
    text = (tmp_path / "images.txt").read_text()
    for old, new in zip(NAMES, names, strict=True):
        text = text.replace(old, new)
    (tmp_path / "images.txt").write_text(text)
    assert [view.name for view in read_reconstruction(tmp_path).views] == sorted(names)
    assert [v.name for v in read_reconstruction(tmp_path, "right eye/1.jpg").views] == [names[1]]


def test_an_nvm_with_fixed_calibration_tells_its_principal_point(tmp_path):
    write_nvm(tmp_path, nvm_text("NVM_V3 FixedK 500 150 500 110"))
    found = read_reconstruction(tmp_path)
    assert found.views[0].K[:2, 2].tolist() == [150, 110] and found.reprojection_px.max() < 1e-4


def test_an_nvms_image_names_may_have_blanks_which_it_writes_as_quotation_marks(tmp_path):
    write_nvm(tmp_path, nvm_text().replace("photo1.jpg", 'my"photo.jpg'))
    write_images(tmp_path, ["my photo.jpg"])
    assert [view.name for view in read_reconstruction(tmp_path).views][1] == "my photo.jpg"


def test_a_list_names_the_images_also_by_paths_of_another_machine(tmp_path):
    write_bundler(tmp_path)
    listed = "/home/x/photo2.jpg 0 500\nC:\\x\\photo0.jpg\n./photo1.jpg\n"
    (tmp_path / "list.txt").write_text(listed)
    names = [view.name for view in read_reconstruction(tmp_path).views]
    assert names == ["photo2.jpg", "photo0.jpg", "photo1.jpg"]


def test_bundlers_file_may_lie_below_its_images(tmp_path):
    write_bundler(tmp_path, inside="bundle")
    for path in (tmp_path, tmp_path / "bundle" / "bundle.out"):
        assert len(read_reconstruction(path).views) == 3


def test_a_photo_without_a_focal_length_was_not_registered(tmp_path, kind):
    folder = WRITERS[kind](tmp_path)
    for file in (*tmp_path.rglob("bundle.out"), *tmp_path.rglob("*.nvm")):
        file.write_text(file.read_text().replace("500.0", "0.0", 1))
    for file in tmp_path.rglob("cameras.txt"):
        file.write_text(file.read_text().replace("500.0", "0.0"))
    for file in tmp_path.rglob("cameras.bin"):
        content = file.read_bytes()
        file.write_bytes(content[:32] + bytes(8) + content[40:])
    if kind.startswith("colmap"):  # all images have one camera there
        with pytest.raises(DataFolderError, match="no photo is registered"):
            read_reconstruction(folder)
    else:
        assert [view.name for view in read_reconstruction(folder).views] == NAMES[1:]


def test_several_reconstructions_in_a_folder_are_told_apart_by_a_path(tmp_path):
    for write in (write_bundler, write_nvm, write_colmap):
        write(tmp_path)
    with pytest.raises(DataFolderError, match=r"several.*cameras\.txt or .*bundle\.out or .*\.nvm"):
        read_reconstruction(tmp_path)
    for path in ("model.nvm", "bundle.out", "sparse/0", "sparse/0/cameras.txt"):
        assert len(read_reconstruction(tmp_path / path).views) == 3


def test_a_folder_without_any_says_what_is_read(tmp_path):
    for path in (tmp_path, tmp_path / "gone", tmp_path / "gone.nvm"):
        with pytest.raises(DataFolderError, match=r"COLMAP.*Bundler.*VisualSfM"):
            read_reconstruction(path)


def test_bundlers_own_example_reprojects_as_its_authors_left_it():
    found = read_reconstruction(shared_data("bundler_kermit"))
    assert len(found.views) == 9 and np.median(found.reprojection_px) < 0.21
