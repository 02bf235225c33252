"""What evo and pycolmap say, asked of another environment's Python: they are no part of ours, evo
by its licence (GPL). Nothing of them is imported here.
"""

import json
import subprocess
import zipfile
from pathlib import Path

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.errors import FleetPoseError

_WITHIN_S = 180.0
_REPROJECT = """
import json, sys, pycolmap
model = pycolmap.Reconstruction(sys.argv[1])
off = {}
for image in model.images.values():
    seen = [point for point in image.points2D if point.has_point3D()]
    off[image.name] = [
        (image.project_point(model.points3D[point.point3D_id].xyz) - point.xy).tolist()
        for point in seen
    ]
json.dump(off, open(sys.argv[2], "w"))
"""


class OracleError(FleetPoseError):
    """The other Python does not have what is asked of it."""


def evo_ate_m(python: Path, truth: Path, estimate: Path, scratch: Path) -> float:
    """Root mean square after one rigid fit, as `evo_ape tum TRUTH ESTIMATE -a` finds it.

    Raises:
        OracleError: it cannot be run.
    """
    results = scratch / f"{estimate.stem}.zip"
    command = [str(python.parent / "evo_ape"), "tum", str(truth), str(estimate), "-a"]
    _run([*command, "--save_results", str(results), "--no_warnings"])
    with zipfile.ZipFile(results) as file:
        return float(json.loads(file.read("stats.json"))["rmse"])


def colmap_residuals_px(python: Path, folder: Path, scratch: Path) -> dict[str, Floats]:
    """By how much pycolmap's projections miss the pixels (N, 2), by the name of the image, in the
    order of its points.

    Raises:
        OracleError: it cannot be run, or does not read the folder.
    """
    results = scratch / "residuals.json"
    _run([str(python), "-c", _REPROJECT, str(folder), str(results)])
    read = json.loads(results.read_text())
    return {name: np.array(off, np.float64).reshape(-1, 2) for name, off in read.items()}


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_WITHIN_S, env={"MPLBACKEND": "agg"}
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise OracleError(
            f"--python: {command[0]} cannot be run ({error}); give the python of an environment "
            "made by 'python -m venv DIR; DIR/bin/pip install evo pycolmap'"
        ) from error
    if done.returncode:
        raise OracleError(
            f"{command[0]} ended with {done.returncode}: {done.stderr.strip()[-300:]}"
        )
