"""A frame's ranges as they go on the wire."""

import numpy as np

from fleetpose.protocol.clouds import decode_scattered
from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel, ScatteredCloud
from fleetpose.robot_agent.cameras.base import ScatteredPoints
from fleetpose.robot_agent.features.packing import cloud_of

MODEL = Camera(
    width=64,
    height=48,
    K=np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]]),
    T_robot_camera=ROBOT_FROM_CAMERA,
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0, 0, 0.01)),
    kind="views",
)


def test_points_outside_the_image_are_left_out_and_those_at_its_border_kept():
    uv = np.array([[-0.4, 0], [-1.6, 5], [63.4, 47.4], [64.2, 5], [30, 20], [30, -3], [np.nan, 1]])
    cloud = cloud_of(ScatteredPoints(uv, np.full(len(uv), 2.0)), MODEL)
    assert isinstance(cloud, ScatteredCloud)
    found, z = decode_scattered(cloud)
    kept = uv[[0, 2, 4]]
    order = np.lexsort((kept[:, 0], kept[:, 1]))
    np.testing.assert_allclose(found, kept[order], atol=1 / 64)
    np.testing.assert_allclose(z, 2.0, atol=0.01)
