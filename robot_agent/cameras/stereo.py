"""Stereo: two images of a calibrated rig become one rectified image with disparities.

A recording is a folder with `left/` and `right/`, images that belong together at the same place
when sorted by name, and the calibration as `robot_agent.cameras.rig` reads it.
"""

import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from protocol.errors import CalibrationError, DataFolderError
from protocol.messages import NoiseModel
from robot_agent.cameras.base import DisparityImage, Frame
from robot_agent.cameras.files import model_of, read_colour
from robot_agent.cameras.replay import replay_order
from robot_agent.cameras.rig import Floats, StereoRig, read_rig

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

_SUBPIXELS = 16  # of OpenCV's fixed point
_BLOCK = 5
_SLOPE_WINDOW = 7
_ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class StereoMatcher:
    """Turns pairs of images into frames. One per camera: not to be shared between threads.

    Args:
        rig: the calibrated pair.
        nearest_m: depth of the nearest thing to see; 7 baselines if not given. Time grows with
            the disparity it asks for.
    """

    def __init__(self, rig: StereoRig, nearest_m: float | None = None) -> None:
        self.rig = rig
        self._rectifier = _Rectifier(rig)
        K, baseline_m = self._rectifier.K, self._rectifier.baseline_m
        if not (np.isfinite(K).all() and 1 < K[0, 0] < 200 * rig.size[0]):
            raise CalibrationError("rectified, no camera is left: check D_left, D_right and R")
        nearest_m = nearest_m or NEAREST_BASELINES * baseline_m
        largest = K[0, 0] * baseline_m / nearest_m
        if largest > rig.size[0] // 2:
            raise CalibrationError(
                f"things {nearest_m:g} m away would move {largest:.0f} px between images of "
                f"{rig.size[0]} px: check the baseline ({baseline_m:g} m), or see less near"
            )
        self._full, self._half = _Sgbm(largest + 1), _Sgbm(largest / 2 + 1)
        self.model = model_of(
            "the stereo calibration",
            width=rig.size[0],
            height=rig.size[1],
            K=K,
            T_robot_camera=self._rectifier.T_robot_rectified,
            noise=NoiseModel.stereo(K[0, 0], baseline_m, DISPARITY_SIGMA_PX, PIXEL_SIGMA_PX),
            kind="stereo",
        )

    def frame(self, left: Image, right: Image, stamp_ns: int) -> Frame:
        """A frame from the two images of one moment, as the cameras gave them.

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
        left, right = self._rectifier.left(left), self._rectifier.right(right)
        disparity = self.disparity(_grey(left), _grey(right))
        assert self.model.noise.focal_baseline_px_m is not None
        ranges = DisparityImage(disparity, self.model.noise.focal_baseline_px_m, 1 / _SUBPIXELS)
        image = left if left.ndim == 3 else cv2.cvtColor(left, cv2.COLOR_GRAY2BGR)
        return Frame(stamp_ns, np.asarray(image, np.uint8), ranges, self.model)

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


class StereoFolder:
    """A recorded stereo camera."""

    def __init__(self, matcher: StereoMatcher, pairs: list[tuple[Path, Path]], replay: str) -> None:
        self._matcher = matcher
        self._pairs = pairs
        self._order = replay_order(len(pairs), replay)

    def frames(self) -> Iterator[Frame]:
        for index in self._order:
            stamp_ns = time.time_ns()
            left, right = (read_colour(path) for path in self._pairs[index])
            yield self._matcher.frame(left, right, stamp_ns)

    def close(self) -> None:
        """Nothing is held open."""


def open_camera(source: str, replay: str) -> StereoFolder:
    """Opens a folder of stereo pairs.

    Args:
        source: the folder.
        replay: see `replay_order`.

    Raises:
        DataFolderError: images are missing.
        CalibrationError: the calibration is missing or impossible.
    """
    folder = Path(source)
    left, right = (_images(folder / side) for side in ("left", "right"))
    if len(left) != len(right):
        raise DataFolderError(
            f"{folder} has {len(left)} left and {len(right)} right images: each needs its partner"
        )
    height, width = read_colour(left[0]).shape[:2]
    matcher = StereoMatcher(read_rig(folder, (width, height)))
    return StereoFolder(matcher, list(zip(left, right, strict=True)), replay)


class _Rectifier:
    """Warps both images so that the same point lies in the same row."""

    def __init__(self, rig: StereoRig) -> None:
        self.K, self.baseline_m = rig.K_left, rig.baseline_m
        self.T_robot_rectified = rig.T_robot_left
        self._maps: list[tuple[npt.NDArray, npt.NDArray]] = []
        if rig.is_rectified:
            return
        R, t = rig.T_right_left[:3, :3], rig.T_right_left[:3, 3:]
        R_rect_left, R_rect_right, P_left, P_right = cv2.stereoRectify(
            rig.K_left, rig.D_left, rig.K_right, rig.D_right, rig.size, R, t,
            flags=cv2.CALIB_ZERO_DISPARITY, alpha=0,
        )[:4]  # fmt: skip
        self.K = np.array(P_left[:, :3], np.float64)
        self.baseline_m = -float(P_right[0, 3] / P_right[0, 0])
        _check_rectified(self.K, self.baseline_m, rig)
        T_left_rectified = np.eye(4)
        T_left_rectified[:3, :3] = R_rect_left.T
        self.T_robot_rectified = rig.T_robot_left @ T_left_rectified
        for K, D, R_rect, P in (
            (rig.K_left, rig.D_left, R_rect_left, P_left),
            (rig.K_right, rig.D_right, R_rect_right, P_right),
        ):
            self._maps.append(
                cv2.initUndistortRectifyMap(K, D, R_rect, P, rig.size, cv2.CV_32FC1)  # pyright: ignore[reportArgumentType]
            )

    def left(self, image: Image) -> Image:
        return self._warp(image, 0)

    def right(self, image: Image) -> Image:
        return self._warp(image, 1)

    def _warp(self, image: Image, side: int) -> Image:
        if not self._maps:
            return image
        return np.asarray(cv2.remap(image, *self._maps[side], cv2.INTER_LINEAR), np.uint8)


def _check_rectified(K: Floats, baseline_m: float, rig: StereoRig) -> None:
    """Distortion or a rotation that cannot be leave hardly anything of the image, or turn it
    inside out.
    """
    zoom = K[0, 0] / rig.K_left[0, 0]
    if not np.isfinite(K).all() or baseline_m <= 0 or not 1 / 3 < zoom < 3:
        raise CalibrationError(
            f"the calibration cannot be rectified (zoom {zoom:.2g}, baseline {baseline_m:.3g} m): "
            "check R, t and the distortion, or calibrate again"
        )


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


def _images(folder: Path) -> list[Path]:
    images = sorted(p for p in folder.glob("*") if p.suffix.lower() in _ENDINGS)
    if not images:
        raise DataFolderError(f"{folder} has no images ({', '.join(_ENDINGS)})")
    return images
