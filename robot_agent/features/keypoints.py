"""Salient points of one image with their inverse depth: what the server matches views by.

SIFT finds and describes them. Descriptors are RootSIFT (Arandjelovic and Zisserman, CVPR 2012: the
square root of the L1-normalised descriptor, whose Euclidean distance is the Hellinger distance),
stored as uint8: `round(512 * sqrt(d / sum))` cut at 255. So a stored descriptor divided by 512 has
length 1 but for rounding.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.clouds import SalientPoints
from fleetpose.protocol.messages import Camera
from fleetpose.robot_agent.cameras.base import Frame, Ranges
from fleetpose.robot_agent.features.inverse_depth import lift_points

EXTRACTOR = "rootsift"
ROOTSIFT_SCALE = 512
BORDER_PX = 2
USUAL_CONTRAST = 0.04


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
    return lifted_points(detect(grey_of(image), 2 * max_points), ranges, model, max_points)


def salient_of(frame: Frame, max_points: int = 1600) -> SalientPoints:
    """The salient points of a frame; none where it has no image: nothing looks like anything in a
    drawing, and the server goes by shapes.
    """
    if frame.has_image:
        return salient_points(frame.image, frame.ranges, frame.model, max_points)
    nothing = np.zeros(0, np.float32)
    return SalientPoints(
        np.zeros((0, 2), np.float32), nothing, nothing, np.zeros((0, 128), np.uint8)
    )


def grey_of(image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """(H, W) of an image (H, W, 3) BGR or (H, W) grey."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)


@dataclass(frozen=True)
class Keypoints:
    """SIFT keypoints: pixels (N, 2), strengths (N,), descriptors (N, 128)."""

    uv: npt.NDArray[np.float64]
    strength: npt.NDArray[np.float32]
    descriptors: npt.NDArray[np.float32]

    @classmethod
    def joined(cls, parts: Sequence["Keypoints"]) -> "Keypoints":
        """All of several sets."""
        return cls(
            np.concatenate([part.uv for part in parts]),
            np.concatenate([part.strength for part in parts]),
            np.concatenate([part.descriptors for part in parts]),
        )

    def at(self, uv: npt.NDArray[np.float64]) -> "Keypoints":
        """The same keypoints at other pixels."""
        return replace(self, uv=uv)

    def inside(self, shape: tuple[int, ...]) -> "Keypoints":
        """Those that lie in an image of a shape (H, W) and away from its border."""
        corner = np.array(shape[1::-1]) - 1 - BORDER_PX
        keep = ((self.uv >= BORDER_PX) & (self.uv <= corner)).all(axis=1)
        return Keypoints(self.uv[keep], self.strength[keep], self.descriptors[keep])


def lifted_points(
    found: Keypoints, ranges: Ranges, model: Camera, max_points: int
) -> SalientPoints:
    """Keypoints with their inverse depth, those with depth first if they are too many, strongest
    first.
    """
    lifted = lift_points(found.uv, ranges, model)
    chosen = np.lexsort((-found.strength, np.isnan(lifted.inverse_depth)))[:max_points]
    chosen = chosen[np.argsort(-found.strength[chosen], kind="stable")]
    return SalientPoints(
        uv=found.uv[chosen].astype(np.float32),
        inverse_depth=lifted.inverse_depth[chosen].astype(np.float32),
        inverse_depth_sigma=lifted.sigma[chosen].astype(np.float32),
        descriptors=root_sift(found.descriptors[chosen]),
    )


def root_sift(sift: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """RootSIFT (N, 128) uint8 of SIFT descriptors (N, 128)."""
    total = np.maximum(sift.sum(axis=1, keepdims=True), 1e-6)
    root = np.rint(ROOTSIFT_SCALE * np.sqrt(sift / total))
    return np.minimum(root, 255).astype(np.uint8)


def detect(grey: npt.NDArray[np.uint8], count: int, contrast: float = USUAL_CONTRAST) -> Keypoints:
    """SIFT of a grey image (H, W): the `count` strongest above a contrast, away from the border."""
    # without precise upscaling OpenCV's SIFT finds points a quarter pixel off
    sift = cv2.SIFT_create(nfeatures=count, contrastThreshold=contrast, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(grey, None)
    if descriptors is None:
        return Keypoints(np.zeros((0, 2)), np.zeros(0, np.float32), np.zeros((0, 128), np.float32))
    uv = np.array([point.pt for point in keypoints], np.float64)
    strength = np.array([point.response for point in keypoints], np.float32)
    return Keypoints(uv, strength, descriptors).inside(grey.shape)
