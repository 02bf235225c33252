"""A reconstruction as a folder of posed views, which everything else reads: its points are their
clouds, the same in all views (`sparse`).
"""

import atexit
import json
import math
import shutil
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from fleetpose.evaluation.data.posed_views import camera_entry
from fleetpose.evaluation.report.output import progress_bar
from fleetpose.protocol.errors import DataFolderError
from fleetpose.robot_agent.reconstructions.model import ReconstructedView
from fleetpose.robot_agent.reconstructions.reading import find_reconstruction, read_reconstruction

_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 98]


def in_metres(data: Path, metres_per_unit: float | None) -> Path:
    """The folder of recorded data; where a scale is told, that of a reconstruction's posed views,
    in metres.

    Raises:
        DataFolderError: a scale is told, but the data is no reconstruction; or it cannot be read.
    """
    if metres_per_unit is None:
        return data
    if not (metres_per_unit > 0 and math.isfinite(metres_per_unit)):
        raise DataFolderError(f"--metres-per-unit {metres_per_unit}: give a number above 0")
    if find_reconstruction(data) is None:
        raise DataFolderError(
            f"{data} is no reconstruction by COLMAP, Bundler or VisualSfM, and in metres already: "
            "leave --metres-per-unit out"
        )
    return as_posed_views(data, metres_per_unit)


def all_in_metres(data: Sequence[Path], metres_per_unit: float | None) -> tuple[Path, ...]:
    """The same of several.

    Raises:
        DataFolderError: as `in_metres`; or a scale is told, and there is no data.
    """
    if metres_per_unit is not None and not data:
        raise DataFolderError("--metres-per-unit is the scale of a reconstruction: give --data")
    return tuple(in_metres(one, metres_per_unit) for one in data)


@cache
def as_posed_views(path: Path, metres_per_unit: float = 1.0) -> Path:
    """Writes the posed views into a folder that goes with the process.

    Raises:
        DataFolderError: the reconstruction cannot be read; the text names what is wrong.
    """
    model = read_reconstruction(path).scaled(metres_per_unit)
    names = [_name(view) for view in model.views]
    if len(set(names)) < len(names):
        raise DataFolderError(f"{path}: two images differ by their ending only: rename one")
    place = Path(tempfile.mkdtemp(prefix="fleetpose-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    out = place / path.resolve().name
    (out / "images").mkdir(parents=True)
    (out / "sparse").mkdir()
    cameras = []
    with progress_bar() as progress:
        for view in progress.track(model.views, description="images"):
            name = _name(view)
            seen, uv, p = model.measured(view)
            cv2.imwrite(str(out / "images" / f"{name}.jpg"), view.picture(), _QUALITY)
            np.savez(out / "sparse" / f"{name}.npz", uv=uv, xyz_cam=p, track_id=seen)
            size = (view.width, view.height)
            cameras.append(camera_entry(f"{name}.jpg", size, view.K, view.T_camera_world))
    (out / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    return out


def _name(view: ReconstructedView) -> str:
    """Of its files: without its ending, all in one folder."""
    return Path(view.name).with_suffix("").as_posix().replace("/", "_")
