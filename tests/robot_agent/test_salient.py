"""Salient points: few enough, strongest first, those with depth preferred."""

import cv2
import numpy as np
import pytest

from fleetpose.protocol.messages import ROBOT_FROM_CAMERA, Camera, NoiseModel
from fleetpose.robot_agent.cameras.base import DepthImage
from fleetpose.robot_agent.features.keypoints import ROOTSIFT_SCALE, root_sift, salient_points

MODEL = Camera(
    width=320,
    height=240,
    K=np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]]),
    T_robot_camera=ROBOT_FROM_CAMERA,
    noise=NoiseModel(pixel_sigma_px=0.5, depth_sigma_m=(0.0, 0.0, 0.001)),
    kind="rgbd",
)


@pytest.fixture(scope="module")
def image():
    noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX)


def everywhere():
    return DepthImage(np.full((240, 320), 2.0, np.float32))


def left_three_quarters():
    depth = np.full((240, 320), np.nan, np.float32)
    depth[:, :240] = 2.0
    return DepthImage(depth)


def test_root_sift_bytes_keep_the_hellinger_distance():
    sift = np.random.default_rng(1).gamma(0.5, 40.0, (50, 128)).astype(np.float32)
    exact = np.sqrt(sift / sift.sum(axis=1, keepdims=True))
    stored = root_sift(sift)
    assert stored.dtype == np.uint8
    again = stored.astype(np.float64) / ROOTSIFT_SCALE
    assert np.abs(again - exact).max() <= 0.5 / ROOTSIFT_SCALE + 1e-6
    assert np.allclose(np.linalg.norm(again, axis=1), 1.0, atol=0.01)


def test_root_sift_of_a_lone_peak_and_of_nothing_stays_a_byte():
    sift = np.zeros((2, 128), np.float32)
    sift[0, 5] = 255
    assert root_sift(sift)[0].max() == 255
    assert root_sift(sift)[1].max() == 0


def test_points_keep_off_the_border_and_have_the_depth_of_the_surface(image):
    points = salient_points(image, everywhere(), MODEL)
    assert len(points.uv) > 100
    assert points.uv.dtype == np.float32
    assert (points.uv >= 2).all()
    assert (points.uv <= (317, 237)).all()
    assert np.allclose(points.inverse_depth, 0.5)
    assert points.descriptors.shape == (len(points.uv), 128)


def test_at_most_as_many_points_as_asked_for_those_with_depth_first(image):
    everything = salient_points(image, left_three_quarters(), MODEL, 2000)
    assert np.isnan(everything.inverse_depth[:100]).any()  # the strongest are not all on the left
    few = salient_points(image, left_three_quarters(), MODEL, 100)
    assert len(few.uv) == 100
    assert np.isfinite(few.inverse_depth).all()


def test_the_strongest_come_first(image):
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    strength = {
        tuple(np.float32(point.pt)): point.response
        for point in cv2.SIFT_create(enable_precise_upscale=True).detect(grey, None)
    }
    points = salient_points(image, everywhere(), MODEL, 100)
    order = [strength[tuple(uv)] for uv in points.uv]
    assert order == sorted(order, reverse=True)


def test_a_blank_image_has_no_salient_points():
    points = salient_points(np.full((240, 320, 3), 90, np.uint8), everywhere(), MODEL)
    assert points.uv.shape == (0, 2)
    assert points.descriptors.shape == (0, 128)


def test_a_corner_is_found_where_it_is():
    """Pixel centres at integers: a blob centred on a pixel is found there, not a quarter beside."""
    rows, columns = np.mgrid[0:240, 0:320]
    blob = 40 + 200 * np.exp(-((columns - 100.0) ** 2 + (rows - 80.0) ** 2) / (2 * 4.0**2))
    image = np.repeat(blob.astype(np.uint8)[..., None], 3, axis=2)
    points = salient_points(image, everywhere(), MODEL)
    assert len(points.uv) > 0
    assert np.abs(points.uv - (100, 80)).max(axis=1).min() < 0.1
