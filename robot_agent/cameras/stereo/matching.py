"""Stereo: two images of a calibrated rig become one rectified image with disparities.

The pairs come from a folder, a video or a device (`stereo.pairs`), the calibration from a file
(`calibrations.reading`).
"""

import logging
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import CalibrationError
from fleetpose.protocol.messages import NoiseModel
from fleetpose.robot_agent.cameras.base import DisparityImage, Frame
from fleetpose.robot_agent.cameras.calibrations.reading import TOOLS, read_rig, read_rig_file
from fleetpose.robot_agent.cameras.folders.files import model_of
from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair, PairSource, open_pairs
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig
from fleetpose.robot_agent.cameras.stereo.video import VideoSettings
from fleetpose.robot_agent.cameras.still import StillImage
from fleetpose.robot_agent.cameras.understood import THIN_DEPTH, understood_of

log = logging.getLogger(__name__)

Image = npt.NDArray[np.uint8]
Disparity = npt.NDArray[np.float32]

# Rendered pairs with noise of 1.5 grey levels gave 0.21 (median) to 0.25 px (root mean square);
# a real rig's calibration adds some. See `tests/robot_agent/test_stereo.py`.
DISPARITY_SIGMA_PX = 0.3
PIXEL_SIGMA_PX = 0.5
NEAREST_BASELINES = 7.0  # nothing nearer is searched for, unless it is asked for
MIN_DISPARITY_PX = 2.0  # beyond, depth is so vague that its error is no longer a Gaussian
MAX_LEFT_RIGHT_DIFFERENCE_PX = 1.0
MIN_SLOPE = 1.5  # mean grey levels per px along the row: below, sensor noise decides the match

_SURELY = 3.0

_SUBPIXELS = 16  # of OpenCV's fixed point
_BLOCK = 5
_SLOPE_WINDOW = 7


class StereoMatcher:
    """Turns pairs of images into frames. One per camera: not to be shared between threads.

    Args:
        rig: the calibrated pair.
        nearest_m: depth of the nearest thing to see; 7 baselines if not given. Time grows with
            the disparity it asks for.
    """

    def __init__(self, rig: StereoRig, nearest_m: float | None = None) -> None:
        self.rig = rig
        self.rectifier = Rectifier(rig)
        K, baseline_m = self.rectifier.K, self.rectifier.baseline_m
        nearest_m = nearest_m or NEAREST_BASELINES * baseline_m
        largest = K[0, 0] * baseline_m / nearest_m
        width, height = self.rectifier.size
        if largest > width // 2:
            raise CalibrationError(
                f"things {nearest_m:g} m away would move {largest:.0f} px between images of "
                f"{width} px: check the baseline ({baseline_m:g} m), or see less near"
            )
        self._full, self._half = _Sgbm(largest + 1), _Sgbm(largest / 2 + 1)
        self._matched: tuple[StillImage, StillImage, DisparityImage] | None = None
        self.model = model_of(
            "the stereo calibration",
            width=width,
            height=height,
            K=K,
            T_robot_camera=self.rectifier.T_robot_rectified,
            noise=NoiseModel.stereo(K[0, 0], baseline_m, DISPARITY_SIGMA_PX, PIXEL_SIGMA_PX),
            kind="stereo",
        )

    def frame(self, left: Image, right: Image, stamp_ns: int) -> Frame:
        """A frame from the two images of one moment, as the cameras gave them. While both show what
        they showed when they were matched last, its ranges are the same object.

        Args:
            left: (H, W, 3) BGR or (H, W) grey, uint8.
            right: the same of the right camera.
            stamp_ns: UTC of the robot's clock.

        Raises:
            CalibrationError: the images are not of the rig's size.
        """
        for name, image in (("left", left), ("right", right)):
            if image.shape[1::-1] != self.rig.size or image.dtype != np.uint8:
                raise CalibrationError(
                    f"{name} image is {image.shape[1]}x{image.shape[0]} {image.dtype}, the "
                    f"calibration is for {self.rig.size[0]}x{self.rig.size[1]} uint8"
                )
        left, right = self.rectifier.left(left), self.rectifier.right(right)
        ranges = self._ranges(_grey(left), _grey(right))
        image = left if left.ndim == 3 else cv2.cvtColor(left, cv2.COLOR_GRAY2BGR)
        return Frame(stamp_ns, np.asarray(image, np.uint8), ranges, self.model)

    def _ranges(self, left: Image, right: Image) -> DisparityImage:
        if self._matched is not None:
            still_left, still_right, ranges = self._matched
            if still_left.shows(left) and still_right.shows(right):
                return ranges
        assert self.model.noise.focal_baseline_px_m is not None
        disparity = self.disparity(left, right)
        ranges = DisparityImage(disparity, self.model.noise.focal_baseline_px_m, 1 / _SUBPIXELS)
        self._matched = StillImage(left), StillImage(right), ranges
        return ranges

    def disparity(self, left: Image, right: Image, left_right_check: bool = True) -> Disparity:
        """Disparities (H, W) of the left of two rectified grey images, px, nan where there is none.

        With the check, what the right image does not see as the same place is taken out.
        """
        found = self._full.match(left, right)
        if left_right_check:
            found[~_consistent(found, self._of_right(left, right))] = np.nan
        found[(found < MIN_DISPARITY_PX) | (_slope(left) < MIN_SLOPE)] = np.nan
        return found

    def _of_right(self, left: Image, right: Image) -> Disparity:
        """Disparities of the right image, good to a pixel: matched at half size, at an eighth of
        the cost.
        """
        height, width = left.shape
        half = width // 2, height // 2
        # the right image is the left one of the mirrored pair
        mirrored = self._half.match(
            *(
                np.asarray(cv2.resize(image[:, ::-1], half, interpolation=cv2.INTER_AREA), np.uint8)
                for image in (right, left)
            )
        )
        found = cv2.resize(mirrored[:, ::-1], (width, height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(found, np.float32) * np.float32(width / half[0])


class StereoCamera:
    """A stereo camera: recorded, a video, or live."""

    def __init__(self, matcher: StereoMatcher, source: PairSource) -> None:
        self._matcher = matcher
        self._source = source

    def frames(self) -> Iterator[Frame]:
        live = self._source.folder is None
        for count, pair in enumerate(self._source.pairs()):
            frame = self._matcher.frame(pair.left, pair.right, pair.stamp_ns)
            if not count:
                self._check_eyes(pair, frame)
            yield replace(frame, raw=(pair.left, pair.right)) if live else frame

    def close(self) -> None:
        self._source.close()

    def _check_eyes(self, pair: ImagePair, frame: Frame) -> None:
        """Hardly any depth at the start has few causes, and one of them can be tried.

        Raises:
            CalibrationError: the other way round there is much more.
        """
        share = understood_of(frame).share or 0.0
        if share >= THIN_DEPTH:
            return
        swapped = self._matcher.frame(pair.right, pair.left, pair.stamp_ns)
        other = understood_of(swapped).share or 0.0
        name = self._source.name
        if other > THIN_DEPTH and other > _SURELY * share:
            raise CalibrationError(
                f"{name}: {share:.0%} of the pixels have depth, {other:.0%} if the eyes change "
                "places: exchange the left and the right images, or R and t of the calibration "
                "are inverted (x_right = R x_left + t, so t[0] is below 0)"
            )
        log.warning(
            "%s: only %.0f %% of the pixels have depth: is a lens dark or covered, does the "
            "calibration fit (robot-agent calibrate-check), is there texture in sight?",
            *(name, 100 * share),
        )


def open_camera(
    source: str,
    replay: str,
    calibration: Path | None = None,
    video: VideoSettings | None = None,
    stop: threading.Event | None = None,
    translation_unit: float | None = None,
) -> StereoCamera:
    """Opens a stereo camera.

    Args:
        source, replay, video, stop: see `open_pairs`.
        calibration: its file; without one it is looked for beside the images.
        translation_unit: metres that one of the calibration's translation is; None: metres.

    Raises:
        DataFolderError: images are missing.
        CameraError: a device or a video cannot be opened.
        CalibrationError: the calibration is missing, impossible, or of another size.
    """
    pairs = open_pairs(source, replay, video, stop)
    try:
        return StereoCamera(StereoMatcher(calibrated(pairs, calibration, translation_unit)), pairs)
    except Exception:
        pairs.close()
        raise


def calibrated(
    pairs: PairSource, calibration: Path | None, translation_unit: float | None = None
) -> StereoRig:
    """The rig of a source.

    Args:
        pairs: the source.
        calibration: the file; without one it is looked for beside the images.
        translation_unit: metres that one of its translation is; None: metres.

    Raises:
        CalibrationError: it is missing, impossible, or made for images of another size.
    """
    if calibration is not None:
        rig = read_rig_file(calibration, pairs.size, translation_unit)
    elif pairs.folder is not None:
        rig = read_rig(pairs.folder, pairs.size, translation_unit)
    else:
        raise CalibrationError(
            f"{pairs.name} needs its calibration: give --calibration FILE of {TOOLS}"
        )
    if rig.size != pairs.size:
        raise CalibrationError(
            f"each eye of {pairs.name} gives {pairs.size[0]}x{pairs.size[1]}, the calibration is "
            f"for {rig.size[0]}x{rig.size[1]}: ask the device for that size with --size (of both "
            "eyes together where they come side by side), or calibrate at the size it has"
        )
    return rig


class _Sgbm:
    """OpenCV's semi-global matcher from disparity 0 up to a largest one."""

    def __init__(self, largest_px: float) -> None:
        self._range = int(np.ceil(largest_px / 16)) * 16
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=0,
            numDisparities=self._range,
            blockSize=_BLOCK,
            P1=8 * _BLOCK**2,
            P2=32 * _BLOCK**2,
            disp12MaxDiff=-1,  # checked against the right image's own disparities instead
            preFilterCap=31,
            uniquenessRatio=8,
            speckleWindowSize=80,
            speckleRange=2,
            mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        )

    def match(self, left: Image, right: Image) -> Disparity:
        # the matcher gives nothing in its first columns, as many as its range: put some before
        wider = [
            cv2.copyMakeBorder(image, 0, 0, self._range, 0, cv2.BORDER_REPLICATE)
            for image in (left, right)
        ]
        raw = self._matcher.compute(*wider)[:, self._range :]
        disparity = raw.astype(np.float32)
        disparity /= _SUBPIXELS
        disparity[raw < 0] = np.nan
        return disparity


def _consistent(left: Disparity, right: Disparity) -> npt.NDArray[np.bool_]:
    """Where the right image's disparity leads back to the same pixel of the left one."""
    columns = np.arange(left.shape[1], dtype=np.float32)
    with np.errstate(invalid="ignore"):
        target = np.rint(np.where(np.isfinite(left), columns - left, -1)).astype(np.intp)
    back = np.take_along_axis(right, np.maximum(target, 0), axis=1)
    with np.errstate(invalid="ignore"):
        return (target >= 0) & (np.abs(back - left) <= MAX_LEFT_RIGHT_DIFFERENCE_PX)


def _slope(image: Image) -> npt.NDArray[np.float32]:
    """Mean change of grey along the row, per px, around each pixel."""
    change = cv2.convertScaleAbs(cv2.Sobel(image, cv2.CV_16S, 1, 0, ksize=3))
    mean = cv2.blur(change, (_SLOPE_WINDOW, _SLOPE_WINDOW))
    return np.asarray(mean, np.float32) / np.float32(8)


def _grey(image: Image) -> Image:
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
