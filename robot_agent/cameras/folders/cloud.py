"""A sensor that gives clouds and no images: lidar, time of flight, radar.

Every file of a folder is a scan, in the order of their names. A scan goes out as a pinhole camera
sees it: an organised one that was taken by a pinhole camera as its depth image, any other as the
points within a wide field of view ahead.
"""

import logging
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, NoiseModel
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.robot_agent.cameras.base import (
    DepthImage,
    Frame,
    OtherKindError,
    Ranges,
    ScatteredPoints,
)
from fleetpose.robot_agent.cameras.folders.cloud_files import ENDINGS, read_points
from fleetpose.robot_agent.cameras.folders.files import model_of
from fleetpose.robot_agent.cameras.replay import replay_order
from fleetpose.robot_agent.features.depth_picture import picture_of

log = logging.getLogger(__name__)

Floats = npt.NDArray[np.float64]
Axes = Literal["robot", "optical"]

FIELD_DEG = (120.0, 90.0)  # across and up, of the points ahead that are sent
WIDTH_PX = 1024
LEAST_POINTS, MOST_POINTS = 10, 200_000
_PINHOLE_PX = 0.5  # an organised cloud whose points are off by less is a pinhole camera's
SCANNER_NOISE = NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.02, 0.001, 0.0))
"""A rotating lidar's: makers state 1 to 3 cm, more where a beam is wide."""
FLIGHT_NOISE = NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.005, 0.0, 0.002))
"""A time-of-flight camera's: makers state some millimetres and half a percent at a few metres."""


class CloudFiles:
    """The scans of a folder as one camera."""

    def __init__(self, files: list[Path], axes: Axes, metres_per_unit: float, replay: str) -> None:
        self._files = files
        self._axes: Axes = axes
        self._metres_per_unit = metres_per_unit
        self._order = replay_order(len(files), replay)

    def frames(self) -> Iterator[Frame]:
        """Scans that have points ahead.

        Raises:
            DataFolderError: none has.
        """
        empty = 0  # in a row
        for index in self._order:
            frame = self._frame(self._files[index])
            empty = empty + 1 if frame is None else 0
            if frame is not None:
                yield frame
            elif empty >= len(self._files):
                raise DataFolderError(
                    f"{self._files[0].parent}: no scan has {LEAST_POINTS} points ahead; are the "
                    f"--axes '{self._axes}' right?"
                )

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, path: Path) -> Frame | None:
        frame = read_frame(path, self._axes, self._metres_per_unit)
        if frame is None:
            log.warning("%s has no %d points ahead: left out", path, LEAST_POINTS)
        return frame


def read_frame(path: Path, axes: Axes = "robot", metres_per_unit: float = 1.0) -> Frame | None:
    """The frame of a scan's file; none where fewer than ten of its points lie ahead.

    Raises:
        DataFolderError: it cannot be read.
        CalibrationError: see `frame_of`.
    """
    points = read_points(path) * metres_per_unit
    return frame_of(points @ ROBOT_FROM_CAMERA[:3, :3] if axes == "robot" else points, str(path))


def frame_of(points: Floats, where: str = "cloud") -> Frame | None:
    """A frame of points (N, 3) or (H, W, 3), metres, in camera axes (x right, y down, z ahead);
    none where fewer than ten lie ahead.

    Raises:
        CalibrationError: an organised cloud is of no camera that can be.
    """
    K = _pinhole_of(points) if points.ndim == 3 else None
    if K is not None:
        height, width = points.shape[:2]
        ahead = np.isfinite(points).all(axis=2) & (points[..., 2] > 0)
        depth = np.where(ahead, points[..., 2], np.nan).astype(np.float32)
        model = _model(where, width, height, K, FLIGHT_NOISE)
        ranges: Ranges = DepthImage(depth)
        count = int(ahead.sum())
    else:
        model = _wide_model(where)
        ranges = _scattered(points.reshape(-1, 3), model)
        count = len(ranges.z)
    if count < LEAST_POINTS:
        return None
    return Frame(time.time_ns(), picture_of(ranges, model), ranges, model, has_image=False)


def open_camera(
    source: str, replay: str, axes: Axes = "robot", metres_per_unit: float = 1.0
) -> CloudFiles:
    """Opens a file or a folder of scans.

    Args:
        source: a file, or a folder of files.
        replay: see `replay_order`.
        axes: of the points: `robot` (x ahead, y left, z up) or `optical` (x right, y down, z
            ahead).
        metres_per_unit: of the files.

    Raises:
        DataFolderError: there is no scan.
    """
    path = Path(source)
    files = [path] if path.is_file() else scans_in(path)
    if not files:
        raise OtherKindError(f"{path} holds no scan: {', '.join(ENDINGS)}")
    return CloudFiles(files, axes, metres_per_unit, replay)


def scans_in(folder: Path) -> list[Path]:
    """The files of a folder that may be scans, in the order of their names."""
    if not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in ENDINGS)


def _wide_model(where: str) -> CameraModel:
    across, up = np.tan(np.radians(np.array(FIELD_DEG)) / 2)
    f = 0.5 * WIDTH_PX / across
    height = round(2 * f * up)
    K = np.array([[f, 0, 0.5 * (WIDTH_PX - 1)], [0, f, 0.5 * (height - 1)], [0, 0, 1.0]])
    return _model(where, WIDTH_PX, height, K, SCANNER_NOISE)


def _model(where: str, width: int, height: int, K: Floats, noise: NoiseModel) -> CameraModel:
    return model_of(
        where,
        width=width,
        height=height,
        K=K,
        T_robot_camera=ROBOT_FROM_CAMERA,
        noise=noise,
        kind="cloud",
    )


def _scattered(points: Floats, model: CameraModel) -> ScatteredPoints:
    """What a camera with this model sees of points (N, 3), thinned where there are too many."""
    points = points[np.isfinite(points).all(axis=1)]
    points = points[points[:, 2] > 1e-3 * max(float(np.abs(points).max(initial=0.0)), 1e-6)]
    uv = (points @ model.K.T)[:, :2] / points[:, 2:]
    inside = ((uv >= -0.5) & (uv < (model.width - 0.5, model.height - 0.5))).all(axis=1)
    uv, z = uv[inside], points[inside, 2]
    if len(z) > MOST_POINTS:
        kept = np.sort(np.random.default_rng(0).choice(len(z), MOST_POINTS, replace=False))
        uv, z = uv[kept], z[kept]
    return ScatteredPoints(uv, z)


def _pinhole_of(points: Floats) -> Floats | None:
    """K (3, 3) of the pinhole camera that took an organised cloud (H, W, 3); none if none did."""
    rows, columns = np.nonzero(np.isfinite(points).all(axis=2) & (points[..., 2] > 0))
    if len(rows) < 100:
        return None
    some = slice(None, None, max(len(rows) // 20_000, 1))
    p = points[rows[some], columns[some]]
    K = np.eye(3)
    for axis, pixels in ((0, columns[some]), (1, rows[some])):
        slopes = np.column_stack((p[:, axis] / p[:, 2], np.ones(len(p))))
        fitted, *_ = np.linalg.lstsq(slopes, pixels.astype(float), rcond=None)
        if np.median(np.abs(slopes @ fitted - pixels)) > _PINHOLE_PX:
            return None
        K[axis, axis], K[axis, 2] = fitted
    return K if min(K[0, 0], K[1, 1]) > 0 else None
