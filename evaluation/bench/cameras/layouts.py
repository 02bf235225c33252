"""Row: folders and videos as they are downloaded are opened, with their true depths."""

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.evaluation.bench.cameras.bars import Bar
from fleetpose.evaluation.bench.cameras.cases import tried
from fleetpose.evaluation.bench.cameras.made import tables
from fleetpose.evaluation.bench.cameras.made.scene import RIG, content, save, seen
from fleetpose.evaluation.bench.cameras.made.variants import Variant
from fleetpose.robot_agent.cameras.stereo.video import VideoSettings

Depth = npt.NDArray[np.float32]
_SIZE: dict[str, Any] = {"width": RIG.size[0], "height": RIG.size[1]}
_COUNT = 3


def bar(scratch: Path) -> Bar:
    """Writes and opens every layout."""
    attempts = [tried(variant, scratch / variant.name) for variant in VARIANTS]
    return Bar("d layouts as downloaded", attempts, unit="opened right")


def _eyes(folder: Path, left: str, right: str, ending: str = "png", name: str = "{:010d}") -> Depth:
    """Images of two eyes in two folders."""
    shot = seen()
    for n in range(_COUNT):
        save(folder / left / f"{name.format(n)}.{ending}", shot.left)
        save(folder / right / f"{name.format(n)}.{ending}", shot.right)
    (folder / "stereo.json").write_text(json.dumps(content(**_SIZE)))
    return shot.depth


def _kitti(folder: Path) -> Depth:
    """With its own calibration."""
    depth_m = _eyes(folder, "image_0", "image_1", name="{:06d}")
    (folder / "stereo.json").unlink()
    f, cx, cy = RIG.K_left[0, 0], RIG.K_left[0, 2], RIG.K_left[1, 2]
    lines = [f"P{k}: {f} 0 {cx} {x} 0 {f} {cy} 0 0 0 1 0" for k, x in enumerate((0.0, -0.5 * f))]
    (folder / "calib.txt").write_text("\n".join(lines))
    return depth_m


def _film(folder: Path, rows_first: bool) -> Depth:
    """A video with both eyes in each image."""
    shot = seen()
    both = np.concatenate((shot.left, shot.right), axis=0 if rows_first else 1)
    code = cv2.VideoWriter.fourcc(*"FFV1")
    size = both.shape[1], both.shape[0]
    writer = cv2.VideoWriter(str(folder / "film.mkv"), cv2.CAP_FFMPEG, code, 20.0, size)
    for _ in range(_COUNT):
        writer.write(both)
    writer.release()
    (folder / "stereo.json").write_text(json.dumps(content(**_SIZE)))
    return shot.depth


def _rgbd(
    folder: Path,
    colour: str,
    depth: str,
    files: dict[str, str],
    steps: float = 1000.0,
    size: tuple[int, int] = (320, 240),
) -> Depth:
    """Colour and depth under names with a place for their number, and files of text beside."""
    depth_m = tables.true_depth()
    for n in range(_COUNT):
        save(folder / colour.format(n), cv2.resize(tables.colour(), size))
        save(folder / depth.format(n), np.rint(depth_m * steps).astype(np.uint16))
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return depth_m


def _list(pattern: str) -> str:
    return "\n".join(pattern.format(n=n, at=f"{100 + n}.25") for n in range(_COUNT))


_MAV, _NS = "mav0/cam", "140363657976355{:04d}"
_K = {"camera-intrinsics.txt": "262.5 0 159.5\n0 262.5 119.5\n0 0 1"}
_FOUR = "262.5 262.5 159.5 119.5"
_LISTS = {f"{kind}.txt": _list("{at} " + kind + "/{n}.png") for kind in ("rgb", "depth")}
_ICL = {"associations.txt": _list("{n} depth/{n}.png {n} rgb/{n}.png")}
_SCANNET = "262.5 0 159.5 0\n0 262.5 119.5 0\n0 0 1 0\n0 0 0 1"
_REPLICA = {"camera": {"w": 320, "h": 240, "fx": 262.5, "fy": 262.5, "cx": 159.5, "cy": 119.5}}
_REPLICA["camera"]["scale"] = 6553.5
_FLAT = [262.5, 0, 0, 0, 262.5, 0, 159.5, 119.5, 1]
_OPEN3D = json.dumps({"width": 320, "height": 240, "intrinsic_matrix": _FLAT})


def _stereo(name: str, write: Callable[[Path], Depth]) -> Variant:
    return Variant(name, "stereo", write, frames=_COUNT)


def _depth(name: str, *given: object, **more: object) -> Variant:
    write = partial(_rgbd, **more)  # pyright: ignore[reportArgumentType]
    return Variant(name, "rgbd", lambda folder: write(folder, *given), frames=_COUNT)  # pyright: ignore[reportArgumentType]


VARIANTS: tuple[Variant, ...] = (
    _stereo(
        "euroc",
        partial(_eyes, left="mav0/cam0/data", right="mav0/cam1/data", name="140363657976355{:04d}"),
    ),
    _stereo("kitti", _kitti),
    _stereo("kitti_colour", partial(_eyes, left="image_2", right="image_3")),
    _stereo("kitti_raw", partial(_eyes, left="image_00/data", right="image_01/data")),
    _stereo("cam0_cam1", partial(_eyes, left="cam0", right="cam1", name="{:04d}")),
    _stereo("tartanair", partial(_eyes, left="image_left", right="image_right")),
    _stereo("eth3d_stereo", partial(_eyes, left="rgb", right="rgb2", name="{:04d}.25")),
    _stereo("realsense_infrared", partial(_eyes, left="infra1", right="infra2")),
    _stereo("upper_case", partial(_eyes, left="Left", right="Right")),
    _stereo("pgm", partial(_eyes, left="left", right="right", ending="pgm")),
    Variant(
        "film_side_by_side",
        "stereo",
        partial(_film, rows_first=False),
        frames=_COUNT,
        source="film.mkv",
        options={"video": VideoSettings(fps=4.0)},
    ),
    Variant(
        "film_top_bottom",
        "stereo",
        partial(_film, rows_first=True),
        frames=_COUNT,
        source="film.mkv",
        options={"video": VideoSettings(fps=4.0, eyes="top-bottom")},
    ),
    _depth("tum", "rgb/{}.png", "depth/{}.png", {**_LISTS, **_K}, steps=5000.0),
    _depth(
        "eth3d", "rgb/{}.png", "depth/{}.png", {**_LISTS, "calibration.txt": _FOUR}, steps=5000.0
    ),
    _depth("icl_nuim", "rgb/{}.png", "depth/{}.png", {**_ICL, **_K}, steps=5000.0),
    _depth(
        "scannet",
        *("color/{}.jpg", "depth/{}.png", {"intrinsic/intrinsic_depth.txt": _SCANNET}),
        size=(640, 480),
    ),
    _depth(
        "replica",
        *("results/frame{:06d}.jpg", "results/depth{:06d}.png"),
        {"cam_params.json": json.dumps(_REPLICA)},
        steps=6553.5,
    ),
    _depth("seven_scenes", "frame-{:06d}.color.png", "frame-{:06d}.depth.png", _K),
    _depth(
        "two_folders", "color/{:05d}.jpg", "depth/{:05d}.png", {"camera_intrinsic.json": _OPEN3D}
    ),
    _depth("two_folders_rgb", "rgb/{:05d}.jpg", "depth/{:05d}.png", _K),
    _depth("pgm_depth", "rgb/{:05d}.ppm", "depth/{:05d}.pgm", _K),
    _depth("pgm_seven_scenes", "frame-{:06d}.color.jpg", "frame-{:06d}.depth.pgm", _K),
    _depth("images_depths", "images/{:05d}.jpg", "depths/{:05d}.png", _K),
)
