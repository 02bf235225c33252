"""What COLMAP, Bundler or VisualSfM left, as a camera: its photos, undistorted, with the points
that each saw.

What it says about poses is not sent. All photos, in the order of their cameras, are the frames of
one camera whose K changes from frame to frame; `view` takes one of them.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, NoiseModel
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.robot_agent.cameras.base import Frame, ScatteredPoints
from fleetpose.robot_agent.cameras.folders.views import MEASURED_PIXEL_SIGMA_PX, UNKNOWN_DEPTH_SIGMA
from fleetpose.robot_agent.cameras.replay import replay_order
from fleetpose.robot_agent.reconstructions.model import ReconstructedView, Reconstruction
from fleetpose.robot_agent.reconstructions.reading import read_reconstruction

_NOISE = NoiseModel(
    pixel_sigma_px=MEASURED_PIXEL_SIGMA_PX, depth_sigma_m=(0.0, UNKNOWN_DEPTH_SIGMA, 0.0)
)


class ReconstructedPhotos:
    """The photos of a reconstruction as one camera."""

    def __init__(self, model: Reconstruction, replay: str) -> None:
        self._model = model
        self._order = replay_order(len(model.views), replay)

    def frames(self) -> Iterator[Frame]:
        for index in self._order:
            yield self._frame(self._model.views[index])

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, view: ReconstructedView) -> Frame:
        _, uv, p = self._model.measured(view)
        points = ScatteredPoints(np.asarray(uv, np.float64), np.asarray(p[:, 2], np.float64))
        return Frame(time.time_ns(), view.picture(), points, _camera_model(view))


def _camera_model(view: ReconstructedView) -> CameraModel:
    try:
        return CameraModel(
            width=view.width,
            height=view.height,
            K=np.asarray(view.K, np.float64),
            T_robot_camera=ROBOT_FROM_CAMERA,
            noise=_NOISE,
            kind="views",
        )
    except ValidationError as error:
        raise CalibrationError(f"{view.image}: {error.errors()[0]['msg']}") from error


def open_camera(
    source: str, replay: str, view: str | None = None, metres_per_unit: float = 1.0
) -> ReconstructedPhotos:
    """Opens a reconstruction.

    Args:
        source: its folder, or its file where a folder holds several.
        replay: see `replay_order`.
        view: the one photo to take, by name, with or without its ending; all if not given.
        metres_per_unit: of the reconstruction, whose scale is arbitrary.

    Raises:
        DataFolderError: it cannot be read, or there is no such photo.
    """
    model = read_reconstruction(Path(source), view).scaled(metres_per_unit)
    return ReconstructedPhotos(model, replay)
