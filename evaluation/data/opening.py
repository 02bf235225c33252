"""Opening recordings of every kind, and reading their points."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fleetpose.evaluation.data.posed_views import open_posed_views
from fleetpose.evaluation.data.reconstructed import as_posed_views, find_reconstruction
from fleetpose.evaluation.data.recording import CloudKind, Recording, TrueView
from fleetpose.evaluation.data.rgbd import open_rgbd, read_depth
from fleetpose.evaluation.data.scans import is_scans, open_scans, scan_points
from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.protocol.errors import DataFolderError


def open_recording(directory: Path, clouds: CloudKind | None = None) -> Recording:
    """Opens a posed-views folder (`cameras.json`), an RGB-D folder (`camera-intrinsics.txt`) or a
    reconstruction by COLMAP, Bundler or VisualSfM.

    Args:
        directory: the folder; of a reconstruction also its file.
        clouds: which clouds of a posed-views folder to use; the only ones, else `sparse_noisy`, if
            not told.

    Raises:
        DataFolderError: it is neither, or a file is missing or cannot be read.
    """
    if (directory / "cameras.json").is_file():
        return open_posed_views(directory, clouds)
    if (directory / "camera-intrinsics.txt").is_file():
        if clouds is not None:
            raise DataFolderError(f"{directory} is an RGB-D folder: leave --clouds out")
        return open_rgbd(directory)
    if is_scans(directory):
        if clouds is not None:
            raise DataFolderError(f"{directory} holds scans: leave --clouds out")
        return open_scans(directory)
    if find_reconstruction(directory) is not None:
        return open_posed_views(as_posed_views(directory), clouds)
    raise DataFolderError(
        f"{directory} is no recording: it holds neither cameras.json (posed views), nor "
        "camera-intrinsics.txt (RGB-D frames), nor poses.txt or T_target_source.txt (scans), nor a "
        "reconstruction by COLMAP, Bundler or VisualSfM"
    )


def open_recordings(directories: Sequence[Path], clouds: CloudKind | None) -> list[Recording]:
    """Opens folders of both kinds: the clouds are those of the folders with posed views.

    Raises:
        DataFolderError: one is no recording, or the only one has no such clouds to choose.
    """

    def kind(directory: Path) -> CloudKind | None:
        posed = (directory / "cameras.json").is_file()
        return clouds if posed or len(directories) == 1 else None

    return [open_recording(directory, kind(directory)) for directory in directories]


def points_of(view: TrueView) -> tuple[Floats, Floats]:
    """Pixels (N, 2) and camera-frame points (N, 3) of a view's cloud, as recorded, without truth.

    Raises:
        DataFolderError: the view has no cloud, or its file cannot be read.
    """
    if view.cloud is None:
        raise DataFolderError(f"view {view.name} has no cloud")
    if view.cloud.suffix == ".npz":
        with np.load(view.cloud) as arrays:
            return arrays["uv"].astype(np.float64), arrays["xyz_cam"].astype(np.float64)
    if view.is_scan:
        return scan_points(view.cloud)
    depth = read_depth(view.cloud)
    rows, columns = np.nonzero(np.isfinite(depth))
    uv = np.column_stack((columns, rows)).astype(np.float64)
    rays = np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(view.K).T
    return uv, rays * depth[rows, columns, None]


def median_depth_m(recording: Recording) -> float:
    """Median z over all points of all views' clouds."""
    depths = [points_of(view)[1][:, 2].astype(np.float32) for view in recording.usable]
    if not depths:
        raise DataFolderError(f"no view of {recording.directory} has a cloud")
    return float(np.median(np.concatenate(depths)))
