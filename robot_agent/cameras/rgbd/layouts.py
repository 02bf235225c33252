"""How folders of RGB-D recordings are laid out, by what lies in them."""

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.cameras.base import OtherKindError
from fleetpose.robot_agent.cameras.folders.pairing import list_images, paired
from fleetpose.robot_agent.cameras.rgbd.lists import MAX_DIFFERENCE_S, associated, paired_already

log = logging.getLogger(__name__)

MM = 1000.0
TUM_STEPS_PER_M = 5000.0
TUM_K = np.array([[525.0, 0.0, 319.5], [0.0, 525.0, 239.5], [0.0, 0.0, 1.0]])
_COLOUR_ENDINGS = (".color_registered.jpg", ".color_registered.png", ".color.jpg", ".color.png")
_DEPTH_FOLDERS = ("depth", "depths", "depth_images")
_COLOUR_FOLDERS = ("rgb", "color", "colour", "image", "images", "colors")


@dataclass(frozen=True)
class Shot:
    """The two files of one frame."""

    colour: Path
    depth: Path


@dataclass(frozen=True)
class Layout:
    """What a folder is.

    Attributes:
        name: of the layout.
        shots: its frames, in order.
        steps_per_m: of its depth images, as the layout has them.
        K: (3, 3) px, that the layout is known to have where no file says it.
        scaled: whether colour images may be larger than those of depth, and are made as large.
    """

    name: str
    shots: list[Shot]
    steps_per_m: float
    K: np.ndarray | None = None
    scaled: bool = False


def layout_of(folder: Path) -> Layout:
    """What a folder is.

    Raises:
        OtherKindError: it holds no frames in any layout that is known.
        DataFolderError: a list of them cannot be read.
    """
    for find in _LAYOUTS:
        layout = find(folder)
        if layout is not None and layout.shots:
            return layout
    raise OtherKindError(
        f"{folder} holds no RGB-D frames: neither frame-*.depth.png with colour (7-Scenes), nor "
        "rgb.txt and depth.txt or associations.txt (TUM, ETH3D, ICL-NUIM), nor depth/ with rgb/ or "
        "color/ (ScanNet), nor results/depth*.png with frame*.jpg (Replica)"
    )


def _tum(folder: Path) -> Layout | None:
    if not ((folder / "depth.txt").is_file() and (folder / "rgb.txt").is_file()):
        return None
    return Layout("TUM", _shots(associated(folder)), TUM_STEPS_PER_M, TUM_K)


def _listed(folder: Path) -> Layout | None:
    for name in ("associations.txt", "associated.txt", "association.txt", "associate.txt"):
        if (folder / name).is_file():
            return Layout("associations", _shots(paired_already(folder / name)), TUM_STEPS_PER_M)
    return None


def _seven_scenes(folder: Path) -> Layout | None:
    shots = []
    for depth in sorted(folder.glob("frame-*.depth.p[ng][gm]")):
        stem = depth.name.removesuffix(depth.suffix).removesuffix(".depth")
        candidates = [folder / (stem + ending) for ending in _COLOUR_ENDINGS]
        colour = next((path for path in candidates if path.is_file()), None)
        if colour is None:
            raise DataFolderError(
                f"{depth} has no colour image: put {candidates[0].name} beside it"
            )
        shots.append(Shot(colour, depth))
    if shots and ".color_registered" not in shots[0].colour.name:
        log.warning("%s: no registered colour, taking .color images as registered to depth", folder)
    return Layout("7-Scenes", shots, MM)


def _replica(folder: Path) -> Layout | None:
    for images in (folder / "results", folder):
        depths = sorted(images.glob("depth[0-9]*.png"))
        shots = [
            Shot(colour, depth)
            for depth in depths
            if (colour := depth.with_name(depth.stem.replace("depth", "frame") + ".jpg")).is_file()
        ]
        if shots:
            return Layout("Replica", shots, MM)
    return None


def _two_folders(folder: Path) -> Layout | None:
    depth = next((folder / name for name in _DEPTH_FOLDERS if (folder / name).is_dir()), None)
    for name in _COLOUR_FOLDERS:
        if depth is not None and (folder / name).is_dir():
            pairs = paired(
                list_images(folder / name), list_images(depth), 1e3 * MAX_DIFFERENCE_S, _WORDS
            )
            scaled = (folder / "intrinsic").is_dir()
            return Layout("ScanNet" if scaled else "two folders", _shots(pairs), MM, None, scaled)
    return None


_WORDS = ("colour and depth", "colour", "depth")
_LAYOUTS: tuple[Callable[[Path], Layout | None], ...] = (
    *(_tum, _listed, _seven_scenes, _replica, _two_folders),
)


def _shots(pairs: Iterable[tuple[Path, Path]]) -> list[Shot]:
    return [Shot(colour, depth) for colour, depth in pairs]
