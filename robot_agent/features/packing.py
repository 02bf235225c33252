"""A frame and its salient points as the message that goes on the wire."""

import numpy as np

from fleetpose.protocol.clouds import (
    SalientPoints,
    decode_depth,
    decode_scattered,
    encode_depth,
    encode_disparity,
    encode_salient,
    encode_scattered,
)
from fleetpose.protocol.messages import Camera, DepthCloud, ScatteredCloud, View, ViewName
from fleetpose.robot_agent.cameras.base import (
    DepthImage,
    DisparityImage,
    Frame,
    Ranges,
    ScatteredPoints,
)
from fleetpose.robot_agent.features.keypoints import EXTRACTOR

SCATTERED_STEP_SIGMAS = 0.1
"""Steps of scattered depths, in median sigmas: rounding then adds 0.04 % to the noise."""
FINEST_STEP_M = 1e-6


def view_of(name: ViewName, frame: Frame, salient: SalientPoints) -> View:
    """Encodes a frame."""
    return View(
        name=name,
        stamp_ns=frame.stamp_ns,
        camera=frame.model,
        cloud=cloud_of(frame.ranges, frame.model),
        salient=encode_salient(salient, EXTRACTOR),
        up_camera=frame.up_camera,
        up_sigma_rad=frame.up_sigma_rad,
        frozen_s=frame.frozen_s,
        has_image=frame.has_image,
    )


def cloud_of(ranges: Ranges, model: Camera) -> DepthCloud | ScatteredCloud:
    """Encodes what was measured, in the form in which it was measured."""
    if isinstance(ranges, DepthImage):
        scale = model.width // ranges.depth_m.shape[1]
        return encode_depth(ranges.depth_m, ranges.step_m, scale)
    if isinstance(ranges, DisparityImage):
        scale = model.width // ranges.disparity_px.shape[1]
        return encode_disparity(
            ranges.disparity_px, ranges.focal_baseline_px_m, ranges.step_px, scale
        )
    seen = _inside(ranges, model)
    return encode_scattered(seen.uv, seen.z, _depth_step_m(seen, model))


def ranges_of(view: View) -> Ranges:
    """What was measured, decoded again."""
    cloud = view.cloud
    if isinstance(cloud, ScatteredCloud):
        return ScatteredPoints(*decode_scattered(cloud))
    return DepthImage(decode_depth(cloud), cloud.step)


def _inside(ranges: ScatteredPoints, model: Camera) -> ScatteredPoints:
    """What lies in the image: a noisy measurement at its border may not, and a view that names a
    pixel far outside is refused as a whole.
    """
    end = (model.width - 0.5, model.height - 0.5)
    inside = ((ranges.uv >= -0.5) & (ranges.uv < end)).all(axis=1)
    return ScatteredPoints(ranges.uv[inside], ranges.z[inside])


def _depth_step_m(ranges: ScatteredPoints, model: Camera) -> float:
    if not len(ranges.z):
        return FINEST_STEP_M
    c0, c1, c2 = model.noise.depth_sigma_m
    z = float(np.median(ranges.z))
    return max(SCATTERED_STEP_SIGMAS * (c0 + c1 * z + c2 * z * z), FINEST_STEP_M)
