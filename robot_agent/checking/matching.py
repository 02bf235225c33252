"""Points that both rectified images of a pair show."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.robot_agent.cameras.stereo.pairs import ImagePair
from fleetpose.robot_agent.cameras.stereo.rectify import Rectifier
from fleetpose.robot_agent.features.keypoints import detect

Floats = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

POINTS = 2000  # per image, the strongest
RATIO = 0.8  # Lowe, IJCV 2004


@dataclass(frozen=True)
class Matches:
    """Points of N pairs of images.

    Attributes:
        left, right: (M, 2) pixels in the rectified images.
        pair: (M,) which pair of images each comes from.
        count: pairs of images.
    """

    left: Floats
    right: Floats
    pair: npt.NDArray[np.intp]
    count: int


def rectified(rectifier: Rectifier, pair: ImagePair) -> tuple[Image, Image]:
    """Both images (H, W) of a pair, grey and rectified."""
    return rectifier.left(_grey(pair.left)), rectifier.right(_grey(pair.right))


def match_pairs(pairs: list[tuple[Image, Image]]) -> Matches:
    """SIFT matches that are mutual and beyond doubt, of rectified grey pairs.

    No row is preferred: a rig that is not as calibrated has its matches elsewhere.
    """
    found = [_matched(left, right) for left, right in pairs]
    return Matches(
        np.concatenate([left for left, _ in found]),
        np.concatenate([right for _, right in found]),
        np.repeat(np.arange(len(found)), [len(left) for left, _ in found]),
        len(found),
    )


def _matched(left: Image, right: Image) -> tuple[Floats, Floats]:
    in_left, in_right = detect(left, POINTS), detect(right, POINTS)
    if min(len(in_left.uv), len(in_right.uv)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    there = _best(in_left.descriptors, in_right.descriptors)
    back = _best(in_right.descriptors, in_left.descriptors)
    mutual = np.flatnonzero((there >= 0) & (back[there] == np.arange(len(there))))
    return in_left.uv[mutual], in_right.uv[there[mutual]]


def _best(queries: npt.NDArray[np.float32], among: npt.NDArray[np.float32]) -> npt.NDArray[np.intp]:
    """The clearly nearest descriptor of each query, -1 where there is none."""
    best = np.full(len(queries), -1, np.intp)
    for first, second in cv2.BFMatcher(cv2.NORM_L2).knnMatch(queries, among, k=2):
        if first.distance < RATIO * second.distance:
            best[first.queryIdx] = first.trainIdx
    return best


def _grey(image: Image) -> Image:
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
