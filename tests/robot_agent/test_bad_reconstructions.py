"""What is wrong with a reconstruction is a sentence, whoever wrote it."""

import struct
from pathlib import Path

import pytest

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.cameras.factory import open_camera
from fleetpose.robot_agent.reconstructions.reading import find_reconstruction, read_reconstruction
from tests.robot_agent.reconstruction_makers import (
    NAMES,
    WRITERS,
    bundler_text,
    nvm_text,
    write_bundler,
    write_colmap,
    write_images,
    write_nvm,
)

HUGE = 10**12


def files_of(folder: Path) -> list[Path]:
    """The files that say something, without the images."""
    return sorted(path for path in folder.rglob("*") if path.is_file() and path.suffix != ".jpg")


def refused(path: Path, said: str) -> None:
    with pytest.raises(DataFolderError, match=said):
        read_reconstruction(path)


@pytest.mark.parametrize("kind", WRITERS)
def test_a_file_that_is_empty_or_cut_anywhere_is_refused(tmp_path, kind):
    folder = WRITERS[kind](tmp_path)
    for file in files_of(folder):
        whole = file.read_bytes()
        model = find_reconstruction(folder)
        assert model is not None
        needed = whole[: whole.index(b"other.jpg")].rstrip()[:-2] if kind == "nvm" else whole
        for kept in (0.0, 0.02, 0.1, 0.3, 0.5, 0.8, 0.95):
            cut = needed[: int(kept * len(needed))]
            file.write_bytes(cut if file.suffix == ".bin" else cut[: cut.rfind(b"\n") + 1])
            refused(model, ".")
        file.write_bytes(whole)
    assert len(read_reconstruction(folder).views) == 3


@pytest.mark.parametrize("kind", WRITERS)
def test_a_missing_image_or_one_that_is_none_is_named(tmp_path, kind):
    folder = WRITERS[kind](tmp_path)
    (image,) = tmp_path.rglob(NAMES[1])
    if kind == "bundler":
        (tmp_path / "list.txt").write_text("\n".join(NAMES))
    image.unlink()
    refused(folder, r"no image photo1\.jpg")
    image.mkdir()
    refused(folder, r"no image photo1\.jpg")
    image.rmdir()
    image.write_text("words")
    refused(folder, r"photo1\.jpg is no image")


@pytest.mark.parametrize("name", ["/gone/photo9.jpg", "x" * 5000 + ".jpg", "photo0.jpg", "\0"])
def test_an_image_name_that_cannot_be_is_a_sentence(tmp_path, name):
    write_nvm(tmp_path, nvm_text().replace("photo1.jpg", name))
    refused(tmp_path, "several of its photos" if name == "photo0.jpg" else "there is no image")


def test_images_of_another_size_are_refused_where_the_size_is_told(tmp_path):
    write_colmap(tmp_path)
    cameras = tmp_path / "sparse" / "0" / "cameras.txt"
    cameras.write_text(cameras.read_text().replace("320 240", "640 480"))
    refused(tmp_path, r"\(320, 240\) pixels.*\(640, 480\)")


def test_a_focal_length_that_is_of_no_camera_is_refused_by_the_agent(tmp_path):
    write_colmap(tmp_path)
    (tmp_path / "sparse" / "0" / "cameras.txt").write_text("4 PINHOLE 320 240 3 500 160 120\n")
    with pytest.raises(CalibrationError, match=r"photo0\.jpg.*focal lengths"):
        list(open_camera("reconstruction", str(tmp_path), "once").frames())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("P6 nonsense", "does not begin with"),
        (bundler_text().replace("10 20 30", "10 x 30", 1), "cannot be read"),
        (bundler_text().replace("10 20 30", "10 nan 30", 1), "not finite"),
        (bundler_text().replace("3 30", "2 30", 1), "cut off"),
        (bundler_text().replace("3 30", f"3 {HUGE}", 1), "cut off"),
        (bundler_text().replace("3 30", f"{HUGE} 30", 1), "cut off"),
        (bundler_text().replace("3 30", "3 inf", 1), "not finite"),
        (bundler_text().replace("3 30", "3 -1", 1), "does not say"),
        (bundler_text().replace("\n3 0 0 ", f"\n{HUGE} 0 0 ", 1), "cut off"),
        (bundler_text().replace("\n3 0 0 ", "\n3 9 0 ", 1), "a camera that there is not"),
        ("# Bundle file v0.3\n0 0\n", "no photo is registered"),
    ],
)
def test_what_is_wrong_with_a_bundle_file(tmp_path, text, said):
    refused(write_bundler(tmp_path, text), said)


def test_a_list_of_another_length_is_refused(tmp_path):
    write_bundler(tmp_path)
    (tmp_path / "list.txt").write_text("photo0.jpg\nphoto1.jpg\n")
    refused(tmp_path, "names 2 images for 3 cameras")
    (tmp_path / "list.txt").write_bytes(b"\xff\xfe\xff")
    refused(tmp_path, "cannot be read")


def test_images_that_are_not_just_as_many_need_a_list(tmp_path):
    write_bundler(tmp_path)
    write_images(tmp_path, ["photo3.jpg"])
    refused(tmp_path, "which image is which of the 3 cameras")


def test_points_that_no_photo_saw_are_no_reconstruction(tmp_path):
    write_bundler(tmp_path, "# Bundle file v0.3\n0 1\n1 2 3\n10 20 30\n0\n")
    refused(tmp_path, "no photo is registered and sees a point")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("NVM_V3_R9T\n", "does not begin with"),
        ("NVM_V3\n", "how many cameras"),
        (nvm_text().replace("\n30\n", "\nmany\n", 1), "how many points"),
        (nvm_text().replace("\n30\n", f"\n{HUGE}\n", 1), "cut off"),
        (nvm_text().replace("\n30\n", "\n" + "9" * 5000 + "\n", 1), "how many points"),
        (nvm_text().replace("\n3\n", f"\n{HUGE}\n", 1), "cut off"),
        (nvm_text().replace("photo1.jpg\t500.0", "photo1.jpg\tnan"), "not finite"),
        (nvm_text().replace("photo1.jpg\t500.0", "photo1.jpg"), "cannot be read|cut off"),
        (nvm_text("NVM_V3 FixedK 500 150 480 110"), "not square"),
        (nvm_text("NVM_V3 FixedK 500"), "FixedK fx cx fy cy"),
    ],
)
def test_what_is_wrong_with_an_nvm(tmp_path, text, said):
    refused(write_nvm(tmp_path, text), said)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        ("cameras", "4 RADIAL", "5 RADIAL", "no camera 4"),
        ("cameras", "-0.05 0.01", "-0.05", "4 parameters of a RADIAL"),
        ("cameras", "-0.05", "nan", "not finite"),
        ("cameras", "RADIAL", "", "320|COLMAP"),
        ("images", "photo1.jpg", "", "no model of COLMAP"),
        ("images", "1.0 2.0 -1", "1.0 2.0", "no model of COLMAP"),
        ("images", "1.0 2.0 -1", "1.0 2.0 999", "saw point 999"),
        ("images", "1.0 2.0 -1", "nan 2.0 -1", "not finite"),
        ("points3D", "points: 30", f"points: {HUGE}", "cut off"),
        ("points3D", "7 ", "x ", "cannot be read"),
    ],
)
def test_what_is_wrong_with_colmaps_text(tmp_path, file, old, new, said):
    write_colmap(tmp_path)
    path = tmp_path / "sparse" / "0" / f"{file}.txt"
    path.write_text(path.read_text().replace(old, new))
    refused(tmp_path, said)


@pytest.mark.parametrize("file", ["cameras", "images", "points3D"])
@pytest.mark.parametrize("count", [HUGE, 2**64 - 1])
def test_a_count_that_is_huge_takes_no_memory(tmp_path, file, count):
    write_colmap(tmp_path, binary=True)
    path = tmp_path / "sparse" / "0" / f"{file}.bin"
    path.write_bytes(struct.pack("<Q", count) + path.read_bytes()[8:])
    refused(tmp_path, "cut off")


def test_a_rotation_that_is_none_is_named(tmp_path):
    write_colmap(tmp_path)
    images = tmp_path / "sparse" / "0" / "images.txt"
    lines = images.read_text().splitlines()
    lines[-2] = " ".join(["1", *4 * ["0"], *lines[-2].split()[5:]])
    images.write_text("\n".join(lines))
    refused(tmp_path, r"photo0\.jpg has no rotation")


def test_a_file_beside_is_missing(tmp_path):
    write_colmap(tmp_path)
    write_images(tmp_path)
    (tmp_path / "sparse" / "0" / "points3D.txt").unlink()
    refused(tmp_path, r"points3D\.txt cannot be read")
