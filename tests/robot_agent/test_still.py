"""A camera that stands still: noise is no change, and every real one is."""

import cv2
import numpy as np
import pytest

from fleetpose.robot_agent.cameras.still import StillImage

SHAPE = (360, 500)
TEXTURE = cv2.GaussianBlur(
    np.random.default_rng(0).uniform(0, 255, (400, 600)).astype(np.float32), (0, 0), 2.0
)


def seen(seed, shift=(0.0, 0.0), noise=2.0, scene=TEXTURE, gain=1.0):
    """(H, W) grey image of the scene, moved by some pixels, with noise of so many grey levels."""
    M = np.array([[1, 0, shift[0] - 20], [0, 1, shift[1] - 20]], np.float32)
    image = gain * cv2.warpAffine(scene, M, SHAPE[::-1], flags=cv2.INTER_CUBIC)
    noisy = image + np.random.default_rng(seed).normal(0, noise, SHAPE)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [0.0, 1.0, 3.0])
def test_noise_alone_is_no_change(noise):
    still = StillImage(seen(1, noise=noise))
    assert all(still.shows(seen(k, noise=noise)) for k in range(2, 22))


@pytest.mark.parametrize("shift", [(0.15, 0.0), (0.0, -0.15), (0.3, 0.3), (3.0, 0.0), (0.0, 40.0)])
def test_a_camera_that_moved_is_noticed(shift):
    still = StillImage(seen(1))
    assert not any(still.shows(seen(k, shift)) for k in range(2, 12))


def test_something_small_that_moves_is_noticed_and_so_is_a_plain_thing_before_a_plain_wall():
    still = StillImage(seen(1))
    passer_by = TEXTURE.copy()
    passer_by[200:240, 300:330] = np.roll(TEXTURE[200:240, 300:330], 4, 1)
    assert not still.shows(seen(2, scene=passer_by))
    wall = np.full_like(TEXTURE, 120.0)
    box = wall.copy()
    box[200:260, 300:350] = 150.0
    assert StillImage(seen(1, scene=wall)).shows(seen(2, scene=wall))
    assert not StillImage(seen(1, scene=wall)).shows(seen(2, scene=box))


def test_another_scene_and_another_size_are_noticed():
    still = StillImage(seen(1))
    assert not still.shows(seen(1, scene=TEXTURE[::-1].copy()))
    assert not still.shows(seen(1)[:-2])
