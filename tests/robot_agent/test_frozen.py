"""A live camera that gives the same image again and again is told from one that stands still."""

import numpy as np

from fleetpose.robot_agent.cameras.base import DepthImage, Frame
from fleetpose.robot_agent.cameras.frozen import LEAST_REPEATS, Repeats
from fleetpose.robot_agent.cameras.stereo.matching import StereoCamera
from fleetpose.robot_agent.cameras.stereo.pairs import PairStream, open_pairs
from fleetpose.robot_agent.cameras.stereo.video import DevicePlayer, VideoSettings
from tests.robot_agent.test_client import DEPTH, IMAGE, MODEL
from tests.robot_agent.video_makers import Device, write_video

SCENE = np.random.default_rng(0).integers(20, 200, (48, 64), dtype=np.uint8)


def noisy(draw: int) -> np.ndarray:
    """The scene with one grey level of noise in one pixel of a hundred."""
    flips = np.random.default_rng(draw).random(SCENE.shape) < 0.01
    return SCENE + flips.astype(np.uint8)


def seconds(images: list[tuple[np.ndarray, ...]], period_s: float = 1.0) -> list[float]:
    repeats = Repeats()
    return [repeats.frozen_s(eyes, k * period_s) for k, eyes in enumerate(images)]


def test_the_noise_of_a_sensor_is_life_and_its_absence_is_none():
    assert seconds([(noisy(k), noisy(-k - 1 + 99)) for k in range(20)]) == [0.0] * 20
    assert seconds([(SCENE, SCENE)] * 6) == [0.0] * LEAST_REPEATS + [3.0, 4.0, 5.0]


def test_one_frozen_eye_is_enough_and_a_new_image_ends_it():
    assert seconds([(noisy(k), SCENE) for k in range(5)])[-1] == 4.0
    assert seconds([(SCENE,)] * 5 + [(noisy(1),), (noisy(2),)])[-2:] == [0.0, 0.0]


def test_a_driver_that_repeats_an_image_for_want_of_a_new_one_is_not_frozen():
    repeated = [(noisy(k // 4),) for k in range(40)]
    assert seconds(repeated, period_s=1 / 30) == [0.0] * 40


def test_the_dark_is_not_frozen():
    assert seconds([(np.zeros((48, 64), np.uint8),)] * 6) == [0.0] * 6


class Shows:
    """A matcher that takes every pair for a frame."""

    def frame(self, left, right, stamp_ns):
        return Frame(stamp_ns, IMAGE, DepthImage(DEPTH), MODEL)


class TexturedDevice(Device):
    def retrieve(self):
        return True, np.dstack([SCENE] * 3)


def test_a_device_shows_what_it_gave_and_a_recording_has_nothing_to_show(tmp_path):
    device = PairStream([DevicePlayer("/dev/video0", VideoSettings(), TexturedDevice())], 10.0)
    film = write_video(tmp_path / "v.mkv", [np.dstack([SCENE] * 3)] * 3, 50)
    for source, eyes in ((device, 2), (open_pairs(film, "hold"), 0)):
        camera = StereoCamera(Shows(), source)
        assert len(next(camera.frames()).raw) == eyes
        camera.close()
