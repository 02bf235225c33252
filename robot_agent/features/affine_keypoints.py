"""The wide set of salient points: for pairs whose views look from very different places.

Points of low contrast too, and points of the image as it would look from the side: squeezed to half
along a few directions (Yu and Morel, ASIFT, 2011), which brings views that are 60 and more degrees
apart near each other. It takes several times as long as the usual set; so it is made on demand,
where the usual set has not settled a pair.
"""

import cv2
import numpy as np
import numpy.typing as npt

from fleetpose.protocol.clouds import SalientPoints, encode_salient
from fleetpose.protocol.errors import CodecError
from fleetpose.protocol.messages import Camera, KeptView, View
from fleetpose.robot_agent.cameras.base import Ranges
from fleetpose.robot_agent.features.keypoints import (
    EXTRACTOR,
    Keypoints,
    detect,
    grey_of,
    lifted_points,
)
from fleetpose.robot_agent.features.packing import ranges_of

Floats = npt.NDArray[np.float64]

MAX_POINTS = 3000
LOW_CONTRAST = 0.015  # OpenCV's usual threshold is 0.04
TILTED_CONTRAST = 0.03
TILT = 2.0  # how much an image is squeezed; a surface seen from 60 deg
DIRECTIONS_DEG = (0.0, 90.0, 45.0, 135.0)


def wide_view(kept: KeptView) -> View:
    """A kept view with the wide set in place of its usual salient points.

    Raises:
        CodecError: the view was kept without an image.
    """
    if not kept.view.has_image:
        return kept.view
    if kept.jpeg is None:
        raise CodecError(f"view {kept.view.name} has no image to find salient points in")
    grey = cv2.imdecode(np.frombuffer(kept.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise CodecError(f"the image of view {kept.view.name} is damaged")
    found = wide_points(np.asarray(grey, np.uint8), ranges_of(kept.view), kept.view.camera)
    return kept.view.model_copy(update={"salient": encode_salient(found, EXTRACTOR)})


def wide_points(
    image: npt.NDArray[np.uint8], ranges: Ranges, model: Camera, max_points: int = MAX_POINTS
) -> SalientPoints:
    """Finds, describes and lifts the wide set; arguments as those of `salient_points`."""
    grey = grey_of(image)
    found = [detect(grey, 2 * max_points, LOW_CONTRAST)]
    found += [tilted(grey, direction, max_points) for direction in DIRECTIONS_DEG]
    return lifted_points(Keypoints.joined(found), ranges, model, max_points)


def tilted(grey: npt.NDArray[np.uint8], direction_deg: float, count: int) -> Keypoints:
    """Salient points of an image (H, W) squeezed along a direction, at their pixels in the image.

    The image is turned, blurred along x as far as squeezing needs, and squeezed along x.
    """
    height, width = grey.shape
    turn = np.radians(direction_deg)
    c, s = np.cos(turn), np.sin(turn)
    A = np.array([[c, -s, 0.0], [s, c, 0.0]])
    corners = A[:, :2] @ np.array([[0, width, width, 0], [0, 0, height, height]], float)
    A[:, 2] = -corners.min(axis=1)
    size = np.ceil(np.ptp(corners, axis=1)).astype(int) + 1
    turned = cv2.warpAffine(grey, A, size.tolist(), borderMode=cv2.BORDER_REPLICATE)
    blurred = cv2.GaussianBlur(turned, (0, 0), sigmaX=0.8 * np.sqrt(TILT**2 - 1), sigmaY=0.01)
    # pixel k of the squeezed image is pixel TILT * k of the blurred one
    squeezed = np.ascontiguousarray(blurred[:, :: int(TILT)], np.uint8)
    keypoints = detect(squeezed, count, TILTED_CONTRAST)
    uv = keypoints.uv * [TILT, 1.0] - A[:, 2]
    return keypoints.at(uv @ A[:, :2]).inside(grey.shape)
