"""Bundler's folders are read as they are, and what is wrong with one is a sentence."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from protocol.errors import DataFolderError
from robot_agent.cameras.factory import open_camera
from robot_agent.reconstructions.bundler import read_bundler
from tests.data import shared_data

F, K1, K2, SIZE = 500.0, -0.05, 0.01, (320, 240)
POINTS = np.random.default_rng(0).uniform((-1, -1, -6), (1, 1, -4), (30, 3))  # before -z


def camera(k: int) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and translation in Bundler's axes."""
    turn, _ = cv2.Rodrigues(np.array([0.02 * k, 0.05 * k, 0.0]))
    return turn, np.array([0.1 * k, 0.0, -0.1])


def pixels(k: int) -> np.ndarray:
    """(P, 2) from the middle of the image, y up."""
    R, t = camera(k)
    P = POINTS @ R.T + t
    p = -P[:, :2] / P[:, 2:]
    r2 = (p**2).sum(axis=1, keepdims=True)
    return F * (1 + K1 * r2 + K2 * r2**2) * p


def bundle(cameras: int = 3, focal: float = F) -> str:
    lines = ["# Bundle file v0.3", f"{cameras} {len(POINTS)}"]
    for k in range(cameras):
        R, t = camera(k)
        lines += [f"{focal if k == 0 else F} {K1} {K2}"]
        lines += [" ".join(map(repr, row.tolist())) for row in (*R, t)]
    seen = [pixels(k) for k in range(cameras)]
    for n, point in enumerate(POINTS):
        lines += [" ".join(map(repr, point.tolist())), "10 20 30"]
        views = [] if n == 5 else [f"{k} {n} {seen[k][n, 0]!r} {seen[k][n, 1]!r}" for k in range(3)]
        lines += [" ".join([str(len(views)), *views])]
    return "\n".join(line.replace("np.float64(", "").replace(")", "") for line in lines) + "\n"


def write(folder: Path, text: str | None = None, images: int = 3, inside: str = "") -> Path:
    place = folder / inside
    place.mkdir(exist_ok=True)
    (place / "bundle.out").write_text(bundle() if text is None else text)
    for k in range(images):
        cv2.imwrite(str(folder / f"photo{k}.jpg"), np.full((SIZE[1], SIZE[0], 3), 90, np.uint8))
    return folder


@pytest.mark.parametrize("inside", ["", "bundle"])
def test_points_project_to_where_they_were_seen_and_axes_are_opencvs(tmp_path, inside):
    found = read_bundler(write(tmp_path, inside=inside))
    assert [view.name for view in found.views] == ["photo0.jpg", "photo1.jpg", "photo2.jpg"]
    assert found.reprojection_px.max() < 1e-3
    for view in found.views:
        assert 5 not in view.seen and len(view.seen) == len(POINTS) - 1
        assert (found.in_camera(view)[:, 2] > 0).all()
        assert np.linalg.det(view.T_camera_world[:3, :3]) == pytest.approx(1.0)
        assert view.picture().shape == (SIZE[1], SIZE[0], 3)
    assert found.colours[0].tolist() == [10, 20, 30]


def test_metres_per_unit_scale_points_and_poses_alike(tmp_path):
    found = read_bundler(write(tmp_path))
    metres = found.scaled(12.5)
    assert np.allclose(metres.in_camera(metres.views[1]), 12.5 * found.in_camera(found.views[1]))
    assert np.allclose(metres.reprojection_px, found.reprojection_px)


def test_a_list_names_the_images_also_by_paths_of_another_machine(tmp_path):
    write(tmp_path)
    (tmp_path / "list.txt").write_text("/home/x/photo2.jpg 0 500\nphoto0.jpg\n./photo1.jpg\n")
    names = [view.image.name for view in read_bundler(tmp_path).views]
    assert names == ["photo2.jpg", "photo0.jpg", "photo1.jpg"]


def test_a_camera_without_a_focal_length_was_not_registered(tmp_path):
    found = read_bundler(write(tmp_path, bundle(focal=0.0)))
    assert [view.name for view in found.views] == ["photo1.jpg", "photo2.jpg"]


@pytest.mark.parametrize("kept", [0.02, 0.1, 0.3, 0.6, 0.95])
def test_a_file_that_was_cut_off_says_so(tmp_path, kept):
    text = bundle()
    with pytest.raises(DataFolderError, match=r"cut off|how many|begin with"):
        read_bundler(write(tmp_path, text[: int(kept * len(text))].rsplit("\n", 1)[0]))


@pytest.mark.parametrize(
    ("text", "images", "said"),
    [
        ("P6 nonsense", 3, "does not begin with"),
        (bundle().replace("10 20 30", "10 x 30", 1), 3, "cannot be read"),
        (bundle(), 2, "which image is which"),
        (bundle().replace("3 30", "2 30", 1), 3, "bundle.out"),
    ],
)
def test_what_is_wrong_is_a_sentence(tmp_path, text, images, said):
    with pytest.raises(DataFolderError, match=said):
        read_bundler(write(tmp_path, text, images))


def test_a_listed_image_that_is_missing_is_named(tmp_path):
    write(tmp_path)
    (tmp_path / "list.txt").write_text("photo0.jpg\ngone.jpg\nphoto2.jpg\n")
    with pytest.raises(DataFolderError, match=r"gone\.jpg"):
        read_bundler(tmp_path)


def test_an_agent_takes_one_photo_in_metres_and_hears_nothing_of_poses(tmp_path):
    write(tmp_path)
    camera = open_camera("bundler", str(tmp_path), "once", view="photo1", metres_per_unit=2)
    (frame,) = camera.frames()
    model = read_bundler(tmp_path)
    assert np.allclose(frame.ranges.z, 2 * model.in_camera(model.views[1])[:, 2])
    assert np.allclose(frame.model.K, model.views[1].K)
    assert not any("world" in name for name in vars(frame))
    with pytest.raises(DataFolderError, match="photo9"):
        open_camera("bundler", str(tmp_path), "once", view="photo9")


def test_bundlers_own_example_reprojects_as_its_authors_left_it():
    found = read_bundler(shared_data("bundler_kermit"))
    assert len(found.views) == 9 and np.median(found.reprojection_px) < 0.21
