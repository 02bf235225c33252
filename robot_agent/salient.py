"""Salient points of one image with their inverse depth: what the server matches views by.

SIFT finds and describes them. Descriptors are RootSIFT (Arandjelovic and Zisserman, CVPR 2012: the
square root of the L1-normalised descriptor, whose Euclidean distance is the Hellinger distance),
stored as uint8: `round(512 * sqrt(d / sum))` cut at 255. So a stored descriptor divided by 512 has
length 1 but for rounding.
"""

import cv2
import numpy as np
import numpy.typing as npt

from protocol.clouds import SalientPoints
from protocol.messages import Camera
from robot_agent.cameras.base import Ranges
from robot_agent.lifting import lift_points

EXTRACTOR = "rootsift"
ROOTSIFT_SCALE = 512
BORDER_PX = 2


def salient_points(
    image: npt.NDArray[np.uint8], ranges: Ranges, model: Camera, max_points: int = 1600
) -> SalientPoints:
    """Finds, describes and lifts salient points, strongest first.

    Args:
        image: (H, W, 3) BGR or (H, W) grey, rectified, full resolution.
        ranges: what was measured, on the grid of the image.
        model: its intrinsics and noise.
        max_points: keep so many of the twice as many strongest, those with depth first.
    """
    grey = image
    if image.ndim == 3:
        grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    uv, strength, descriptors = detect(grey, 2 * max_points)
    lifted = lift_points(uv, ranges, model)
    chosen = np.lexsort((-strength, np.isnan(lifted.inverse_depth)))[:max_points]
    chosen = chosen[np.argsort(-strength[chosen], kind="stable")]
    return SalientPoints(
        uv=uv[chosen].astype(np.float32),
        inverse_depth=lifted.inverse_depth[chosen].astype(np.float32),
        inverse_depth_sigma=lifted.sigma[chosen].astype(np.float32),
        descriptors=root_sift(descriptors[chosen]),
    )


def root_sift(sift: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """RootSIFT (N, 128) uint8 of SIFT descriptors (N, 128)."""
    total = np.maximum(sift.sum(axis=1, keepdims=True), 1e-6)
    root = np.rint(ROOTSIFT_SCALE * np.sqrt(sift / total))
    return np.minimum(root, 255).astype(np.uint8)


def detect(
    grey: npt.NDArray[np.uint8], count: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """SIFT of a grey image (H, W): pixels (N, 2), strengths (N,), descriptors (N, 128), as many as
    the `count` strongest away from the border.
    """
    # without precise upscaling OpenCV's SIFT finds points a quarter pixel off
    sift = cv2.SIFT_create(nfeatures=count, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(grey, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros((0, 128), np.float32)
    uv = np.array([point.pt for point in keypoints], np.float64)
    strength = np.array([point.response for point in keypoints], np.float32)
    corner = np.array(grey.shape[::-1]) - 1 - BORDER_PX
    inside = ((uv >= BORDER_PX) & (uv <= corner)).all(axis=1)
    return uv[inside], strength[inside], descriptors[inside]
