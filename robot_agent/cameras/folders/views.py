"""Posed-views folders: photos with a cloud of scattered points each.

`cameras.json` names the views with their size and K, `images/` holds the photos, and a folder of
clouds holds an npz per view with `xyz_cam` (N, 3). Whatever the folder says about poses is not
read. All views, in the order of their names, are the frames of one camera whose K may change from
frame to frame.
"""

import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
from pydantic import ValidationError

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, NoiseModel
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.robot_agent.cameras.base import Frame, OtherKindError, ScatteredPoints
from fleetpose.robot_agent.cameras.folders.files import noise_of, read_colour, read_json
from fleetpose.robot_agent.cameras.replay import replay_order

STRIPPED_CLOUDS = "clouds"
TRIANGULATED_PIXEL_SIGMA_PX = 0.5  # of each eye, in clouds that state a baseline
MEASURED_PIXEL_SIGMA_PX = 0.7
UNKNOWN_DEPTH_SIGMA = 0.003  # share of z


@dataclass(frozen=True)
class Shot:
    """One view: its entry in cameras.json and its two files."""

    entry: dict[str, Any]
    image: Path
    cloud: Path


class ViewsFolder:
    """The views of a folder as one camera."""

    def __init__(self, folder: Path, shots: list[Shot], noise: Any, replay: str) -> None:
        self._folder = folder
        self._shots = shots
        self._noise = noise
        self._order = replay_order(len(shots), replay)

    def frames(self) -> Iterator[Frame]:
        for index in self._order:
            yield self._frame(self._shots[index])

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, shot: Shot) -> Frame:
        stamp_ns = time.time_ns()
        image = read_colour(shot.image)
        arrays = _read_cloud(shot.cloud)
        z = arrays["xyz_cam"][:, 2]
        model = self._model(shot, _noise_model(shot, self._noise, arrays, z, self._folder))
        if image.shape[:2] != (model.height, model.width):
            raise CalibrationError(
                f"{shot.image} is {image.shape[1]}x{image.shape[0]}, but cameras.json says "
                f"{model.width}x{model.height}"
            )
        return Frame(stamp_ns, image, _scattered(arrays["xyz_cam"], model), model)

    def _model(self, shot: Shot, noise: NoiseModel) -> CameraModel:
        try:
            return CameraModel(
                width=shot.entry["width"],
                height=shot.entry["height"],
                K=np.asarray(shot.entry["K"], np.float64),
                T_robot_camera=ROBOT_FROM_CAMERA,
                noise=noise,
                kind="views",
            )
        except (ValidationError, KeyError, TypeError, ValueError) as error:
            raise CalibrationError(
                f"{self._folder / 'cameras.json'}: view {shot.entry['name']} needs width, "
                "height and a pinhole K"
            ) from error


def open_camera(
    source: str, replay: str, clouds: str | None = None, view: str | None = None
) -> ViewsFolder:
    """Opens a posed-views folder.

    Args:
        source: the folder.
        replay: see `replay_order`.
        clouds: the folder of clouds to take, e.g. `sparse_noisy`; `clouds` if not given.
        view: the one view to take, by name, with or without its ending; all if not given.

    Raises:
        OtherKindError: it has no `cameras.json`.
        DataFolderError: another file is missing, or there is no such view.
        CalibrationError: a view lacks its size or K.
    """
    folder = Path(source)
    if not (folder / "cameras.json").is_file():
        raise OtherKindError(f"{folder} holds no cameras.json with posed views")
    content = read_json(folder / "cameras.json")
    entries = content.get("cameras") if isinstance(content, dict) else None
    if not isinstance(entries, list) or not all(
        isinstance(e, dict) and "name" in e for e in entries
    ):
        raise DataFolderError(f"{folder / 'cameras.json'} has no list 'cameras' of named views")
    cloud_folder = _cloud_folder(folder, clouds)
    shots = [
        Shot(entry, folder / "images" / entry["name"], cloud)
        for entry in sorted(entries, key=lambda e: str(e["name"]))
        if view is None or view in (entry["name"], Path(entry["name"]).stem)
        if (cloud := cloud_folder / f"{Path(entry['name']).stem}.npz").is_file()
    ]
    if not shots:
        wanted = "views" if view is None else f"view '{view}'"
        raise DataFolderError(f"{folder} has no {wanted} with a cloud in {cloud_folder.name}/")
    return ViewsFolder(folder, shots, content.get("noise"), replay)


def _cloud_folder(folder: Path, clouds: str | None) -> Path:
    chosen = folder / (clouds or STRIPPED_CLOUDS)
    if not chosen.is_dir():
        there = sorted(path.parent.name for path in folder.glob("*/*.npz"))
        raise DataFolderError(
            f"{folder} has no clouds '{chosen.name}'; there are: "
            f"{', '.join(dict.fromkeys(there)) or 'none'}"
        )
    return chosen


def _read_cloud(path: Path) -> dict[str, npt.NDArray[Any]]:
    """The arrays that are needed of a cloud, and no others."""
    try:
        with np.load(path, allow_pickle=False) as arrays:
            names = [name for name in ("xyz_cam", "sigma_z") if name in arrays]
            cloud = {name: np.asarray(arrays[name], np.float64) for name in names}
    except (OSError, ValueError, TypeError, EOFError, BadZipFile, zlib.error) as error:
        raise DataFolderError(f"{path} cannot be read as a cloud: {error}") from error
    if "xyz_cam" not in cloud or cloud["xyz_cam"].ndim != 2 or cloud["xyz_cam"].shape[1] != 3:
        raise DataFolderError(f"{path} needs an array xyz_cam of shape (N, 3)")
    return cloud


def _scattered(xyz_cam: npt.NDArray[Any], model: CameraModel) -> ScatteredPoints:
    """Points with the pixels they project to, so that pixel and depth give back the very point."""
    xyz = np.asarray(xyz_cam, np.float64)
    xyz = xyz[np.isfinite(xyz).all(axis=1) & (xyz[:, 2] > 0)]
    uv = (xyz @ model.K.T)[:, :2] / xyz[:, 2:]
    inside = ((uv >= -0.5) & (uv < (model.width - 0.5, model.height - 0.5))).all(axis=1)
    return ScatteredPoints(uv[inside], xyz[inside, 2])


def _noise_model(
    shot: Shot,
    folder_noise: Any,
    arrays: dict[str, npt.NDArray[Any]],
    z: npt.NDArray[np.float64],
    folder: Path,
) -> NoiseModel:
    """The noise as stated, else from the cloud's sigmas, else from its baseline, else a guess."""
    stated = shot.entry.get("noise", folder_noise)
    if stated is not None:
        return noise_of(stated, folder / "cameras.json")
    if "sigma_z" in arrays and len(z):
        if len(arrays["sigma_z"]) != len(z):
            raise DataFolderError(f"{shot.cloud} needs one sigma_z per point")
        quadratic = float(np.median(arrays["sigma_z"] / z**2))
        stated = {"pixel_sigma_px": MEASURED_PIXEL_SIGMA_PX, "depth_sigma_m": (0, 0, quadratic)}
        return noise_of(stated, shot.cloud)
    index_file = shot.cloud.parent / "index.json"
    index = read_json(index_file) if index_file.is_file() else {}
    entry = index.get(shot.entry["name"]) if isinstance(index, dict) else None
    baseline_m = entry.get("baseline_m") if isinstance(entry, dict) else None
    if baseline_m:
        # both eyes are off by the pixel sigma, independently: their difference by sqrt(2) of it
        disparity_sigma_px = TRIANGULATED_PIXEL_SIGMA_PX * np.sqrt(2)
        try:
            focal_px, baseline_m = float(shot.entry["K"][0][0]), float(baseline_m)
            return NoiseModel.stereo(
                focal_px, baseline_m, disparity_sigma_px, TRIANGULATED_PIXEL_SIGMA_PX
            )
        except (KeyError, IndexError, TypeError, ValueError, ZeroDivisionError) as error:
            raise CalibrationError(
                f"{shot.entry['name']} needs a focal length in pixels in cameras.json and a "
                f"baseline_m in {index_file}"
            ) from error
    return NoiseModel(
        pixel_sigma_px=MEASURED_PIXEL_SIGMA_PX, depth_sigma_m=(0.0, UNKNOWN_DEPTH_SIGMA, 0.0)
    )
