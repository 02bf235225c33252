"""Recorded RGB-D cameras: folders of colour and depth images, uint16, 0 and 65535 = none."""

import logging
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, NoiseModel
from fleetpose.protocol.messages import Camera as CameraModel
from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.robot_agent.cameras.calibrations.lens import check_centre
from fleetpose.robot_agent.cameras.folders.files import (
    NO_DEPTH,
    model_of,
    read_colour,
    read_depth,
    read_raw_depth,
)
from fleetpose.robot_agent.cameras.replay import replay_order
from fleetpose.robot_agent.cameras.rgbd.intrinsics import (
    FILES,
    Intrinsics,
    intrinsics_in,
    read_intrinsics,
)
from fleetpose.robot_agent.cameras.rgbd.layouts import MM, TUM_STEPS_PER_M, Layout, Shot, layout_of

log = logging.getLogger(__name__)

FURTHEST_M = 6.0  # beyond, a Kinect's depth is noise
NEAREST_M = 0.3  # before, structured light, time of flight and stereo chips give none
_SHARE = 5.0  # percent of the pixels that may be nearer, or further, all the same
TUM_SIZE = (640, 480)
_SAME_VIEW = 0.02  # of the sides' ratio: ScanNet's 1296x968 and 640x480
_NEAR_M, _FAR_M = FURTHEST_M / 5, 10.0  # where all that a room has is nearer, or as far as any
_LOOKED_AT = 8  # depth images of a recording
KINECT_NOISE = NoiseModel(pixel_sigma_px=0.7, depth_sigma_m=(0.0008, 0.0, 0.0016))
"""A Kinect's axial noise 0.0012 + 0.0019 (z - 0.4)^2 (Nguyen, Izadi and Lovell, 3DIMPVT 2012).

As a polynomial without negative coefficients: at most 30 % more between 0.5 and 5 m, 2 % less."""


class RgbdRecording:
    """A recorded RGB-D camera; every frame gets the time at which it is shown."""

    def __init__(self, layout: Layout, known: Intrinsics, steps_per_m: float, replay: str) -> None:
        self._shots, self._scaled = layout.shots, layout.scaled
        self._known, self._steps_per_m = known, steps_per_m
        self._order = replay_order(len(layout.shots), replay)

    def frames(self) -> Iterator[Frame]:
        for index in self._order:
            yield self._frame(self._shots[index])

    def close(self) -> None:
        """Nothing is held open."""

    def _frame(self, shot: Shot) -> Frame:
        stamp_ns = time.time_ns()
        image = read_colour(shot.colour)
        depth = read_depth(shot.depth, self._steps_per_m, FURTHEST_M)
        if self._scaled and image.shape[:2] != depth.shape:
            image = _scaled_to(image, depth.shape)
        if image.shape[:2] != depth.shape:
            raise CalibrationError(
                f"{shot.colour.name} is {image.shape[1]}x{image.shape[0]}, its depth "
                f"{depth.shape[1]}x{depth.shape[0]}: register the colour images to the depth images"
            )
        return Frame(stamp_ns, image, DepthImage(depth), self._model(*depth.shape))

    def _model(self, height: int, width: int) -> CameraModel:
        return model_of(
            f"the calibration of {self._shots[0].depth.parent}",
            width=width,
            height=height,
            K=self._known.K,
            T_robot_camera=ROBOT_FROM_CAMERA,
            noise=self._known.noise or KINECT_NOISE,
            kind="rgbd",
        )


def open_camera(
    source: str, replay: str, calibration: Path | None = None, depth_scale: float | None = None
) -> RgbdRecording:
    """Opens a folder in any layout of `layouts`.

    Args:
        source: the folder.
        replay: `once`, `loop`, `pingpong` or `hold`.
        calibration: the file with the intrinsics; None: one that lies in the folder.
        depth_scale: steps of its depth images per metre; None: what that file or the layout says,
            where that makes depths that such a camera can have.

    Raises:
        DataFolderError: the folder holds no frames of a known layout.
        CalibrationError: no intrinsics.
    """
    folder = Path(source)
    layout = layout_of(folder)
    known = intrinsics_in(folder) if calibration is None else read_intrinsics(calibration)
    known = known or _usual(folder, layout)
    rows, columns = read_raw_depth(layout.shots[0].depth).shape
    check_centre(known.K, (columns, rows), f"the calibration of {folder}")
    steps_per_m = known.steps_per_m or layout.steps_per_m
    if depth_scale is None:
        _check_depths([shot.depth for shot in layout.shots], steps_per_m)
    log.info(
        "recording layout=%s frames=%d f=%.0f steps_per_m=%g",
        *(layout.name, len(layout.shots), known.K[0, 0], depth_scale or steps_per_m),
    )
    return RgbdRecording(layout, known, depth_scale or steps_per_m, replay)


def _usual(folder: Path, layout: Layout) -> Intrinsics:
    """What the layout is known to have, where no file says it.

    Raises:
        CalibrationError: nothing is known of it.
    """
    height, width = read_raw_depth(layout.shots[0].depth).shape
    if layout.K is None or (width, height) != TUM_SIZE:
        raise CalibrationError(
            f"{folder} has no calibration: put the 3x3 matrix of the depth camera, or fx fy cx cy, "
            f"into {FILES[0]} there, or give --calibration FILE (known are {', '.join(FILES[1:])}, "
            "and any JSON or YAML with fx, fy, cx, cy)"
        )
    log.warning("%s: no %s, taking TUM's default f 525, c 319.5 239.5", folder, FILES[0])
    return Intrinsics(layout.K)


def _scaled_to(image: npt.NDArray[np.uint8], shape: tuple[int, ...]) -> npt.NDArray[np.uint8]:
    """A larger colour image of the same view at the size of its depth."""
    rows, columns = shape
    if abs(image.shape[1] / image.shape[0] - columns / rows) > _SAME_VIEW * columns / rows:
        return image
    return np.asarray(cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA), np.uint8)


def _check_depths(paths: list[Path], steps_per_m: float) -> None:
    """Layouts do not say their unit: one that cannot be shows in depths that no camera has."""
    path = paths[0]
    looked_at = [read_raw_depth(one) for one in paths[:: -(-len(paths) // _LOOKED_AT)]]
    raw = np.concatenate([one.reshape(-1) for one in looked_at])
    depth = raw[(raw > 0) & (raw < NO_DEPTH)] / steps_per_m
    if not depth.size:
        return
    near, middle, far = np.percentile(depth, (_SHARE, 50, 100 - _SHARE))
    in_fives = bool((raw[raw < NO_DEPTH] % 5 == 0).all())  # of a sensor that counts mm
    if steps_per_m == TUM_STEPS_PER_M:
        other, wrong = MM, far < _NEAR_M or (far < _FAR_M / 5 and not in_fives)
    else:
        other, wrong = TUM_STEPS_PER_M, steps_per_m == MM and in_fives and far > FURTHEST_M
    if near >= NEAREST_M and middle <= FURTHEST_M and not wrong:
        return
    meant = "are in millimetres" if other == MM else "have TUM's scale"
    raise DataFolderError(
        f"{path} would show {near:.2g} to {far:.2g} m at {steps_per_m:g} steps per metre, as its "
        f"layout has it, and no such camera does: give --depth-scale STEPS, {other:g} if its "
        f"depths {meant}, {steps_per_m:g} if they are right"
    )
