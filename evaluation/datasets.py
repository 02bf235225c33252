"""Recordings with ground truth: posed views and RGB-D folders. Truth stays in the evaluation.

Camera frames have OpenCV axes; `T_world_camera` maps camera points to the world, metres.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from evaluation.geometry import Floats, inverse, nearest_rotation, rigid
from protocol.errors import DataFolderError

CloudKind = Literal["sparse", "sparse_noisy", "stereo_pair_sparse", "stereo_dense"]
CLOUD_KINDS: tuple[CloudKind, ...] = (
    "sparse",
    "sparse_noisy",
    "stereo_pair_sparse",
    "stereo_dense",
)
DEPTH_UNIT_M = 0.001
_LEAST_POINTS = 10
_NO_DEPTH = 65535  # written by some Kinect recordings beside 0


@dataclass(frozen=True)
class TrueView:
    """One view with its truth.

    Attributes:
        index: place in the list of all views of the recording sorted by name.
        name: of the image file (posed views) or of the frame (RGB-D), e.g. `frame-000010`.
        image: the colour image, registered to the depth where there is one; of a scan, which has
            none, the scan.
        cloud: the npz cloud or the depth image; none if this view has no cloud of the chosen kind.
        width, height, K: pinhole camera, px.
        T_world_camera: (4, 4), rotation projected to SO(3).
        partner: name of the view that was its second eye, for stereo clouds.
        baseline_m: distance to that partner.
        ring_angle_deg: place on the ring, where the recording is one.
    """

    index: int
    name: str
    image: Path
    cloud: Path | None
    width: int
    height: int
    K: Floats
    T_world_camera: Floats
    partner: str | None = None
    baseline_m: float | None = None
    ring_angle_deg: float | None = None

    @property
    def is_scan(self) -> bool:
        """Whether it is a cloud without an image."""
        return self.image == self.cloud


@dataclass(frozen=True)
class Recording:
    """A folder of views with truth; `clouds` is none for RGB-D folders."""

    directory: Path
    clouds: CloudKind | None
    views: tuple[TrueView, ...]

    @property
    def is_rgbd(self) -> bool:
        return self.clouds is None

    @property
    def usable(self) -> tuple[TrueView, ...]:
        """The views that have a cloud."""
        return tuple(view for view in self.views if view.cloud is not None)

    def view(self, index: int) -> TrueView:
        """A view by its index, which is not its place where frames without truth are left out."""
        return next(view for view in self.views if view.index == index)

    def tracks(self, view: TrueView) -> tuple[npt.NDArray[np.int64], Floats] | None:
        """Track ids (N,) and pixels (N, 2) of a view's points in `sparse/`, whatever the clouds."""
        return None if self.is_rgbd else _tracks(self.directory / "sparse" / _npz(view.name))


@lru_cache(maxsize=2048)
def _tracks(path: Path) -> tuple[npt.NDArray[np.int64], Floats] | None:
    if not path.exists():
        return None
    with np.load(path) as arrays:
        return arrays["track_id"], arrays["uv"].astype(np.float64)


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
        return _open_posed_views(directory, clouds)
    if (directory / "camera-intrinsics.txt").is_file():
        if clouds is not None:
            raise DataFolderError(f"{directory} is an RGB-D folder: leave --clouds out")
        return _open_rgbd(directory)
    from evaluation.scans import is_scans, open_scans

    if is_scans(directory):
        if clouds is not None:
            raise DataFolderError(f"{directory} holds scans: leave --clouds out")
        return open_scans(directory)
    from evaluation.reconstructed import as_posed_views, find_reconstruction

    if find_reconstruction(directory) is not None:
        return _open_posed_views(as_posed_views(directory), clouds)
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
        from evaluation.scans import scan_points

        return scan_points(view.cloud)
    depth = read_depth(view.cloud)
    rows, columns = np.nonzero(np.isfinite(depth))
    uv = np.column_stack((columns, rows)).astype(np.float64)
    rays = np.column_stack((uv, np.ones(len(uv)))) @ np.linalg.inv(view.K).T
    return uv, rays * depth[rows, columns, None]


def read_depth(path: Path) -> Floats:
    """(H, W) metres from a 16-bit millimetre PNG, nan where there is none."""
    import cv2

    raw = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.dtype != np.uint16 or raw.ndim != 2:
        raise DataFolderError(f"{path} is no 16-bit depth image")
    return np.where((raw == 0) | (raw == _NO_DEPTH), np.nan, raw * DEPTH_UNIT_M)


def median_depth_m(recording: Recording) -> float:
    """Median z over all points of all views' clouds."""
    depths = [points_of(view)[1][:, 2].astype(np.float32) for view in recording.usable]
    if not depths:
        raise DataFolderError(f"no view of {recording.directory} has a cloud")
    return float(np.median(np.concatenate(depths)))


def are_partners(a: TrueView, b: TrueView) -> bool:
    """Whether one view was the other's second eye: their stereo clouds hold identical points."""
    return a.partner == b.name or b.partner == a.name


def shared_tracks(recording: Recording, a: TrueView, b: TrueView) -> int | None:
    """How many track ids two views have in common in `sparse/`; none where there are no tracks."""
    tracks_a, tracks_b = recording.tracks(a), recording.tracks(b)
    if tracks_a is None or tracks_b is None:
        return None
    return len(np.intersect1d(tracks_a[0], tracks_b[0]))


def in_ring_order(views: tuple[TrueView, ...]) -> tuple[TrueView, ...]:
    """Views by their angle on the ring; in the order of their names where there is none."""
    if any(view.ring_angle_deg is None for view in views):
        return views
    return tuple(sorted(views, key=lambda view: (view.ring_angle_deg, view.name)))


def _npz(name: str) -> str:
    return Path(name).with_suffix(".npz").name


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} cannot be read: {error}") from error


def _open_posed_views(directory: Path, clouds: CloudKind | None) -> Recording:
    there: list[CloudKind] = [kind for kind in CLOUD_KINDS if (directory / kind).is_dir()]
    clouds = clouds or (there[0] if len(there) == 1 else "sparse_noisy")
    if clouds not in there:
        raise DataFolderError(
            f"{directory} has no clouds '{clouds}'; --clouds can be {', '.join(there)}"
        )
    folder = directory / clouds
    index_path = folder / "index.json"
    partners = _json(index_path) if index_path.exists() else {}
    entries = _json(directory / "cameras.json")
    entries = entries["cameras"] if isinstance(entries, dict) else entries
    try:
        entries = sorted(entries, key=lambda entry: entry["name"])
        views = tuple(
            _posed_view(directory, folder, number, entry, partners.get(entry["name"], {}))
            for number, entry in enumerate(entries)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise DataFolderError(f"{directory}/cameras.json: {error!r} in a camera") from error
    return Recording(directory, clouds, views)


def _posed_view(
    directory: Path, folder: Path, index: int, entry: dict[str, Any], pair: dict[str, Any]
) -> TrueView:
    R = nearest_rotation(np.asarray(entry["R_world_to_cam"], np.float64).reshape(3, 3))
    t = np.asarray(entry["t_world_to_cam"], np.float64).reshape(3)
    cloud = folder / _npz(entry["name"])
    ring_angle = entry.get("ring_angle_deg")
    return TrueView(
        index=index,
        name=entry["name"],
        image=directory / "images" / entry["name"],
        cloud=cloud if _has_points(cloud) else None,
        width=int(entry["width"]),
        height=int(entry["height"]),
        K=np.asarray(entry["K"], np.float64).reshape(3, 3),
        T_world_camera=inverse(rigid(R, t)),
        partner=pair.get("partner"),
        baseline_m=pair.get("baseline_m"),
        ring_angle_deg=None if ring_angle is None else float(ring_angle),
    )


def _has_points(cloud: Path) -> bool:
    """Whether there is a cloud that a robot could send: where it sees nothing it has none."""
    if not cloud.exists():
        return False
    with np.load(cloud) as arrays:
        return len(arrays["uv"]) >= _LEAST_POINTS


def _open_rgbd(directory: Path) -> Recording:
    K = _matrix(directory / "camera-intrinsics.txt", (3, 3))
    depths = sorted(directory.glob("frame-*.depth.png"))
    if not depths:
        raise DataFolderError(f"{directory} has no frame-*.depth.png")
    width, height = _image_size(depths[0])
    views = []
    for index, depth in enumerate(depths):
        name = re.sub(r"\.depth\.png$", "", depth.name)
        pose = _matrix(directory / f"{name}.pose.txt", (4, 4))
        if not np.isfinite(pose).all():
            continue  # tracking was lost: such a frame has no truth, the others keep their places
        views.append(
            TrueView(
                index=index,
                name=name,
                image=_colour_image(directory, name),
                cloud=depth,
                width=width,
                height=height,
                K=K,
                T_world_camera=rigid(nearest_rotation(pose[:3, :3]), pose[:3, 3]),
            )
        )
    return Recording(directory, None, tuple(views))


def _colour_image(directory: Path, name: str) -> Path:
    for ending in ("color_registered.jpg", "color.jpg"):
        path = directory / f"{name}.{ending}"
        if path.exists():
            return path
    raise DataFolderError(f"{directory}/{name} has no colour image")


def _image_size(path: Path) -> tuple[int, int]:
    height, width = read_depth(path).shape
    return width, height


def _matrix(path: Path, shape: tuple[int, int]) -> Floats:
    try:
        return np.loadtxt(path).reshape(shape)
    except (OSError, ValueError) as error:
        raise DataFolderError(f"{path} is no {shape[0]}x{shape[1]} matrix: {error}") from error
