"""Whether lengths come out right, by one that is known: a chessboard's squares, or two points.

Rows say nothing of the baseline: a rig whose baseline is 5 % too long sees a world that is 5 % too
large, and everything in it fits.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.base import DisparityImage
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.features.inverse_depth import lift_points

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

_CORNER_SIGMA_PX = 0.1  # of a chessboard's corner, OpenCV's sector-based detector
_PATCH = 8  # half size, px
_REACH_PX = 4  # how far around the disparity a patch is searched for
_MAX_DIFFERENCE_PX = 1.0
_STEP = 1e-5


class CheckError(FleetPoseError):
    """What is to be measured cannot be; the sentence says what to give instead."""


@dataclass(frozen=True)
class Length:
    """A known length as the rig measures it.

    Attributes:
        known_m, measured_m: of it, metres.
        sigma_m: of the measured one.
        of: what was measured, for people.
    """

    known_m: float
    measured_m: float
    sigma_m: float
    of: str

    @property
    def deviation(self) -> float:
        """Share by which lengths come out too long."""
        return self.measured_m / self.known_m - 1

    @property
    def sigma(self) -> float:
        """Of the deviation."""
        return self.sigma_m / self.known_m


def board_length(
    pairs: list[tuple[Image, Image]], rectifier: Rectifier, board: tuple[int, int], square_m: float
) -> Length:
    """The side of a chessboard's squares, from all pairs that show it.

    The board's size in the left image says how far away it is, its disparities say so times the
    baseline: their ratio is the baseline's error, whatever the way the board leans.

    Args:
        pairs: rectified grey images.
        rectifier: of the calibration.
        board: inner corners along and across.
        square_m: side of a square.

    Raises:
        CheckError: no pair shows the whole board.
    """
    ratios, sigmas = [], []
    for left, right in pairs:
        corners = [_corners(eye, board) for eye in (left, right)]
        if corners[0] is None or corners[1] is None:
            continue
        ratio, sigma = _baseline_ratio(corners[0], corners[1], rectifier, board, square_m)
        ratios.append(ratio)
        sigmas.append(sigma)
    if not ratios:
        raise CheckError(
            f"no pair shows a chessboard of {board[0]}x{board[1]} inner corners to both eyes: hold "
            "it nearer and flat, and count the corners between squares, not the squares"
        )
    mean = float(np.mean(ratios))
    between = float(np.std(ratios, ddof=1)) if len(ratios) > 1 else 0.0
    # views of a board that is held still share their errors: no smaller than that of one
    sigma = max(float(np.median(sigmas)), between / np.sqrt(len(ratios)))
    return Length(
        square_m,
        square_m / mean,
        square_m * sigma / mean**2,
        f"the chessboard's squares in {len(ratios)} of {len(pairs)} pairs",
    )


def points_length(
    matcher: StereoMatcher, pair: tuple[Image, Image], points: Floats, known_m: float
) -> Length:
    """The distance of two points.

    Args:
        matcher: of the rig.
        pair: rectified grey images.
        points: (2, 2) pixels in the left one.
        known_m: their true distance.

    Raises:
        CheckError: a point has no depth, or two ways of measuring it disagree.
    """
    model = matcher.model
    inside = (points >= 0) & (points <= (model.width - 1, model.height - 1))
    if not inside.all():
        raise CheckError(
            f"--points {points.ravel().tolist()} are not in the rectified left image of "
            f"{model.width}x{model.height}: --save shows it"
        )
    focal_baseline = model.K[0, 0] * matcher.rectifier.baseline_m
    disparity = matcher.disparity(*pair)
    lifted = lift_points(points, DisparityImage(disparity, focal_baseline, 1 / 16), model)
    for uv, inverse_depth in zip(points, lifted.inverse_depth, strict=True):
        _confirm(pair, uv, focal_baseline * inverse_depth)
    x = np.concatenate((points.ravel(), lifted.inverse_depth))
    sigma = np.array((*[model.noise.pixel_sigma_px] * 4, *lifted.sigma))
    gradient = np.array(
        [
            (_distance(x + d, model.K) - _distance(x - d, model.K)) / (2 * _STEP)
            for d in _STEP * np.eye(6)
        ]
    )
    sigma_m = float(np.linalg.norm(gradient * sigma))
    return Length(known_m, _distance(x, model.K), sigma_m, "the distance of the two points")


def _distance(x: Floats, K: Floats) -> float:
    """Of two points, from their pixels (4 numbers) and inverse depths (2)."""
    uv1 = np.column_stack((x[:4].reshape(2, 2), np.ones(2)))
    one, other = uv1 @ np.linalg.inv(K).T / x[4:, None]
    return float(np.linalg.norm(one - other))


def _confirm(pair: tuple[Image, Image], uv: Floats, disparity: float) -> None:
    """Searches the point's patch in the right image and compares.

    Raises:
        CheckError: there is no disparity, or the patch lies elsewhere.
    """
    where = f"point {uv[0]:g},{uv[1]:g}"
    if not np.isfinite(disparity):
        raise CheckError(f"{where} has no depth: choose a place with texture that both eyes see")
    found = _patch_disparity(pair, uv, disparity)
    if found is None or abs(found - disparity) > _MAX_DIFFERENCE_PX:
        raise CheckError(
            f"{where} is matched in two ways, with disparities {disparity:.1f} and "
            f"{'none' if found is None else f'{found:.1f}'} px: choose a place with more texture, "
            "away from edges of depth"
        )


def _patch_disparity(pair: tuple[Image, Image], uv: Floats, disparity: float) -> float | None:
    """Disparity of the best place of the left patch in the same rows of the right image, by
    normalised correlation; None where patches leave the images.
    """
    left, right = pair
    u, v = np.rint(uv).astype(int)
    middle = round(float(u - disparity))
    far = _PATCH + _REACH_PX
    height, width = left.shape
    if not (_PATCH <= v < height - _PATCH and _PATCH <= u < width - _PATCH):
        return None
    if not far <= middle < width - far:
        return None
    rows = slice(v - _PATCH, v + _PATCH + 1)
    patch = left[rows, u - _PATCH : u + _PATCH + 1]
    score = cv2.matchTemplate(
        right[rows, middle - far : middle + far + 1], patch, cv2.TM_CCOEFF_NORMED
    )[0]
    return float(u - (middle - _REACH_PX + int(np.argmax(score))))


def _corners(image: Image, board: tuple[int, int]) -> Floats | None:
    """(N, 2) inner corners, row by row; None where the board is not whole."""
    found, corners = cv2.findChessboardCornersSB(image, board, flags=cv2.CALIB_CB_ACCURACY)
    return np.asarray(corners, np.float64).reshape(-1, 2) if found else None


def _baseline_ratio(
    left: Floats, right: Floats, rectifier: Rectifier, board: tuple[int, int], square_m: float
) -> tuple[float, float]:
    """The true baseline over the calibrated one, and its sigma, by one pair."""
    if _rms(left - right, 1) > _rms(left - right[::-1], 1):
        right = right[::-1]  # the board looks the same from below
    along, across = board
    places = np.zeros((along * across, 3))
    places[:, :2] = np.mgrid[:along, :across].T.reshape(-1, 2) * square_m
    _, turn, shift = cv2.solvePnP(places, left, rectifier.K, None)
    R = cv2.Rodrigues(turn)[0]
    z = (places @ R.T + shift.ravel())[:, 2]
    ratios = (left - right)[:, 0] * z / (rectifier.K[0, 0] * rectifier.baseline_m)
    # the distance of the board by its size in the image, and the mean of the disparities
    extent = np.linalg.norm(left - left.mean(axis=0), axis=1)
    of_distance = _CORNER_SIGMA_PX / np.sqrt((extent**2).sum())
    scatter = float(ratios.std(ddof=1)) / np.sqrt(len(ratios))
    return float(ratios.mean()), float(np.hypot(scatter, ratios.mean() * of_distance))


def _rms(values: Floats, column: int) -> float:
    spread = values[:, column]
    return float(np.sqrt((spread**2).mean()))
