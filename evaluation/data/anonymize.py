"""What an agent may know: images, clouds, intrinsics and noise, under random names, no truth."""

import json
import random
import shutil
import string
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fleetpose.evaluation.data.recording import CloudKind, Recording, TrueView
from fleetpose.protocol.errors import DataFolderError

NOISY_PIXEL_SIGMA_PX = 0.7
STEREO_PIXEL_SIGMA_PX = 0.5
STEREO_DISPARITY_SIGMA_PX = 0.7  # both eyes' pixel noise together
SPARSE_DEPTH_SIGMA_PER_Z = 0.003


@dataclass(frozen=True)
class StrippedFolder:
    """A folder for one agent; `views` are its frames in the order in which the agent meets them."""

    path: Path
    views: tuple[TrueView, ...]

    @property
    def camera(self) -> Literal["views", "rgbd", "cloud"]:
        """The agent's `--camera`."""
        if (self.path / "cameras.json").exists():
            return "views"
        return "rgbd" if (self.path / "camera-intrinsics.txt").exists() else "cloud"


def random_name(rng: random.Random, first: str = "r") -> str:
    """A robot's name that says nothing about its place, e.g. `rk3x9a`."""
    return first + "".join(rng.choices(string.ascii_lowercase + string.digits, k=5))


def distinct_names(count: int, rng: random.Random) -> list[str]:
    """Random names for robots."""
    names: dict[str, None] = {}
    while len(names) < count:
        names[random_name(rng)] = None
    return list(names)


def strip(
    recording: Recording, views: Sequence[TrueView], folder: Path, rng: random.Random
) -> StrippedFolder:
    """Writes a new folder with what a robot's own camera would give for these views, in order.

    Raises:
        DataFolderError: a view has no cloud, or a file is missing.
    """
    folder.mkdir(parents=True)
    try:
        if views[0].is_scan:
            _strip_scans(views, folder, rng)
        elif recording.is_rgbd:
            _strip_rgbd(views, folder)
        else:
            assert recording.clouds is not None
            _strip_posed(recording.clouds, views, folder, rng)
    except OSError as error:
        raise DataFolderError(f"{recording.directory} lacks a file: {error}") from error
    return StrippedFolder(folder, tuple(views))


def noise_model(clouds: CloudKind, view: TrueView) -> dict[str, Any]:
    """The noise of a posed view's cloud, as its camera would state it.

    Raises:
        DataFolderError: the recording does not say what the noise depends on.
    """
    focal_px = float(view.K[0, 0])
    if clouds == "sparse":
        return _noise(STEREO_PIXEL_SIGMA_PX, (0.0, SPARSE_DEPTH_SIGMA_PER_Z, 0.0), None)
    if clouds == "sparse_noisy":
        c2 = _fitted_c2(view)
        return _noise(NOISY_PIXEL_SIGMA_PX, (0.0, 0.0, c2), STEREO_PIXEL_SIGMA_PX / c2)
    if not view.baseline_m:
        raise DataFolderError(f"{clouds}/index.json does not tell the baseline of {view.name}")
    focal_baseline = focal_px * view.baseline_m
    c2 = STEREO_DISPARITY_SIGMA_PX / focal_baseline
    return _noise(STEREO_PIXEL_SIGMA_PX, (0.0, 0.0, c2), focal_baseline)


def _noise(
    pixel_sigma_px: float, depth_sigma_m: tuple[float, float, float], focal_baseline: float | None
) -> dict[str, Any]:
    return {
        "pixel_sigma_px": pixel_sigma_px,
        "depth_sigma_m": list(depth_sigma_m),
        "focal_baseline_px_m": focal_baseline,
    }


def _fitted_c2(view: TrueView) -> float:
    """c2 of sigma(z) = c2 z^2; the recorded sigmas follow the true depths, hence the median."""
    assert view.cloud is not None
    with np.load(view.cloud) as arrays:
        if "sigma_z" not in arrays:
            raise DataFolderError(f"{view.cloud} has no sigma_z")
        return float(np.median(arrays["sigma_z"] / arrays["xyz_cam"][:, 2] ** 2))


def _strip_posed(
    clouds: CloudKind, views: Sequence[TrueView], folder: Path, rng: random.Random
) -> None:
    (folder / "images").mkdir()
    (folder / "clouds").mkdir()
    cameras = []
    for number, view in enumerate(views):
        if view.cloud is None:
            raise DataFolderError(f"view {view.name} has no cloud of kind {clouds}")
        # The first letters keep the order of the views, the rest of the name is chance.
        name = f"{_letters(number)}{random_name(rng, '')}{view.image.suffix}"
        shutil.copyfile(view.image, folder / "images" / name)
        with np.load(view.cloud) as arrays:
            np.savez(
                folder / "clouds" / Path(name).with_suffix(".npz").name,
                uv=arrays["uv"],
                xyz_cam=arrays["xyz_cam"],
            )
        cameras.append(
            {
                "name": name,
                "width": view.width,
                "height": view.height,
                "K": view.K.tolist(),
                "noise": noise_model(clouds, view),
            }
        )
    (folder / "cameras.json").write_text(json.dumps({"cameras": cameras}, indent=1))


def _letters(number: int) -> str:
    """aaa, aab, ...: in order, and never like the number of a photo."""
    return "".join(chr(ord("a") + number // 26**place % 26) for place in (2, 1, 0))


def _strip_rgbd(views: Sequence[TrueView], folder: Path) -> None:
    np.savetxt(folder / "camera-intrinsics.txt", views[0].K)
    for number, view in enumerate(views):
        assert view.cloud is not None
        name = f"frame-{number:06d}"
        shutil.copyfile(view.cloud, folder / f"{name}.depth.png")
        ending = view.image.name.split(".", 1)[1]
        shutil.copyfile(view.image, folder / f"{name}.{ending}")


def _strip_scans(views: Sequence[TrueView], folder: Path, rng: random.Random) -> None:
    for number, view in enumerate(views):
        name = f"{_letters(number)}{random_name(rng, '')}{view.image.suffix}"
        shutil.copyfile(view.image, folder / name)
