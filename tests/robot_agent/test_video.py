"""Stereo from videos and devices: always the newest pair, at the source's own pace."""

import json
import threading
import time
from itertools import pairwise

import numpy as np
import pytest
import yaml

from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.agent import paced
from fleetpose.robot_agent.cameras.base import CameraError
from fleetpose.robot_agent.cameras.stereo import pairs as pairs_module
from fleetpose.robot_agent.cameras.stereo import video as video_module
from fleetpose.robot_agent.cameras.stereo.matching import open_camera
from fleetpose.robot_agent.cameras.stereo.pairs import PairStream, open_pairs
from fleetpose.robot_agent.cameras.stereo.video import DevicePlayer, VideoSettings
from tests.robot_agent.video_makers import Device, number_of, numbered, write_video

FPS = 20.0


@pytest.fixture
def opened():
    """Closes what a test opened."""
    sources = []

    def keep(source):
        sources.append(source)
        return source

    yield keep
    for source in sources:
        source.close()


@pytest.fixture
def film(tmp_path):
    """40 numbered images, both eyes side by side."""
    images = [np.hstack((numbered(k), numbered(k + 1))) for k in range(40)]
    return write_video(tmp_path / "both.mkv", images, FPS)


def live(*devices, max_skew_ms=10.0, stop=None):
    players = [
        DevicePlayer(f"/dev/video{k}", VideoSettings(), device) for k, device in enumerate(devices)
    ]
    return PairStream(players, max_skew_ms, stop)


def test_a_video_plays_at_its_own_pace_however_rarely_it_is_looked_at(opened, film):
    source = opened(open_pairs(film, "once"))
    taken = list(paced(source.pairs(), 5.0, threading.Event()))
    numbers = np.array([number_of(pair.left) for pair in taken])
    stamps_ns = [pair.stamp_ns for pair in taken]
    assert stamps_ns == sorted(stamps_ns)
    assert len(taken) > 2 and np.diff(numbers).min() > 1, "it waits for who looks"
    assert [number_of(pair.right) for pair in taken] == [k + 1 for k in numbers]


def test_a_video_begins_with_its_first_image_and_ends(opened, tmp_path):
    name = write_video(tmp_path / "v.mkv", [np.hstack([numbered(k)] * 2) for k in range(4)], 50)
    numbers = [number_of(pair.left) for pair in opened(open_pairs(name, "once")).pairs()]
    assert numbers[0] == 0
    assert numbers == sorted(set(numbers))
    assert numbers[-1] <= 3


def test_a_looped_video_starts_over_and_a_held_one_stands_still(opened, tmp_path):
    name = write_video(tmp_path / "v.mkv", [np.hstack([numbered(k)] * 2) for k in range(3)], 50)
    looped = opened(open_pairs(name, "loop")).pairs()
    numbers = [number_of(next(looped).left) for _ in range(8)]
    assert max(numbers) <= 2
    assert any(b < a for a, b in pairwise(numbers))
    held = opened(open_pairs(name, "hold")).pairs()
    assert [number_of(next(held).left) for _ in range(5)] == [0] * 5


def test_a_video_can_be_given_another_pace(opened, film):
    source = opened(open_pairs(film, "once", VideoSettings(fps=200.0)))
    began_s = time.monotonic()
    assert number_of(list(source.pairs())[-1].left) > 30
    assert time.monotonic() - began_s < 40 / FPS, "its own pace takes longer"


def test_two_videos_give_the_images_that_belong_together(opened, tmp_path):
    left = write_video(tmp_path / "l.mkv", [numbered(k) for k in range(30)], 60)
    right = write_video(tmp_path / "r.mkv", [numbered(k + 40) for k in range(30)], 60)
    taken = list(opened(open_pairs(f"{left},{right}", "once")).pairs())
    assert len(taken) >= 5
    assert all(number_of(pair.right) == number_of(pair.left) + 40 for pair in taken)
    assert all(pair.skew_ms == 0 for pair in taken)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"size": (32, 48)}, "same size"),
        ({"fps": 10.0}, "30 Hz.*10"),
        ({"count": 4}, "5 frames.*4"),
    ],
)
def test_two_videos_that_do_not_belong_together_are_refused(tmp_path, change, says):
    left = write_video(tmp_path / "l.mkv", [numbered(0)] * 5)
    images = [numbered(0, change.get("size", (64, 48)))] * change.get("count", 5)
    right = write_video(tmp_path / "r.mkv", images, change.get("fps", 30.0))
    with pytest.raises(CameraError, match=says):
        open_pairs(f"{left},{right}", "once")


def test_what_cannot_be_played_is_refused_and_says_why(film, tmp_path):
    with pytest.raises(DataFolderError, match=r"pingpong.*once, loop, hold"):
        open_pairs(film, "pingpong")
    with pytest.raises(DataFolderError, match="neither a folder, a video file nor a device"):
        open_pairs(str(tmp_path / "nothing.mkv"), "once")
    (tmp_path / "text.mkv").write_text("no video")
    with pytest.raises(CameraError, match="cannot be read as a video"):
        open_pairs(str(tmp_path / "text.mkv"), "once")
    with pytest.raises(CameraError, match="128x48, not 640x480"):
        open_pairs(film, "once", VideoSettings(size=(640, 480)))
    with pytest.raises(DataFolderError, match="left,right"):
        open_pairs("a,b,c", "once")


def test_a_device_that_does_not_exist_ends_with_what_there_is(monkeypatch, tmp_path):
    (tmp_path / "video0").touch()
    monkeypatch.setattr(video_module, "_DEVICES", tmp_path)
    with pytest.raises(CameraError, match=r"no camera .*video99; there are .*video0"):
        open_pairs(str(tmp_path / "video99"), "once")
    (tmp_path / "video0").unlink()
    with pytest.raises(CameraError, match="no camera /dev/video99; no video device is there"):
        open_pairs("99", "once")


def test_a_device_always_gives_the_newest_image_and_decodes_no_other(opened):
    device = Device(fps=20, size=(128, 48))
    source = opened(live(device))
    ages, gone = [], threading.Event()
    for pair in paced(source.pairs(), 3.0, gone):
        ages.append((device.true_number() - number_of(pair.left)) % 80)
        assert time.time_ns() - pair.stamp_ns < 0.2e9
        if len(ages) == 6:
            gone.set()
    assert np.median(ages) <= 1  # a queue of four would make it three or four
    assert device.retrieved <= len(ages) + 1


def test_a_device_without_stamps_is_stamped_when_its_image_comes(opened):
    frames = opened(live(Device(fps=20, size=(128, 48), stamps=False))).pairs()
    before_ns = time.time_ns()
    pair = next(frames)
    assert before_ns <= pair.stamp_ns <= time.time_ns()


def test_an_unplugged_device_is_opened_again(opened):
    device = Device(size=(128, 48))
    frames = opened(live(device)).pairs()
    next(frames)
    device.plugged.clear()
    threading.Timer(0.3, device.plugged.set).start()
    next(frames)
    next(frames)
    assert device.opened >= 2


def test_a_device_that_stays_away_ends_with_a_sentence(opened, monkeypatch):
    monkeypatch.setattr(video_module, "RECONNECT_S", 0.2)
    device = Device(size=(128, 48))
    frames = opened(live(device)).pairs()
    next(frames)
    device.plugged.clear()
    with pytest.raises(CameraError, match=r"video0 stopped giving images.*plug"):
        list(frames)


def test_a_device_that_hangs_ends_with_a_sentence_and_a_stop_ends_the_waiting(opened, monkeypatch):
    device = Device(size=(128, 48))
    stop = threading.Event()
    device.hangs.set()
    try:
        waiting = opened(live(device, stop=stop)).pairs()
        threading.Timer(0.2, stop.set).start()
        assert next(waiting, None) is None
        monkeypatch.setattr(pairs_module, "SILENCE_S", 0.3)
        with pytest.raises(CameraError, match="video0 gave no image"):
            next(opened(live(device)).pairs())
    finally:
        device.goes_on.set()


@pytest.mark.parametrize("offset_s", [0.004, -0.004])
def test_two_devices_are_paired_by_time_and_their_difference_is_measured(opened, offset_s):
    began_s = time.monotonic()
    left, right = Device(20, began_s=began_s), Device(20, offset_s, began_s=began_s)
    frames = opened(live(left, right, max_skew_ms=20.0)).pairs()
    taken = [next(frames) for _ in range(5)]
    assert all(number_of(pair.left) == number_of(pair.right) for pair in taken)
    np.testing.assert_allclose([pair.skew_ms for pair in taken], 1e3 * offset_s, atol=1e-3)


def test_pairs_too_far_apart_are_dropped_and_in_the_end_refused(opened, monkeypatch, caplog):
    monkeypatch.setattr(pairs_module, "SKEW_PATIENCE_S", 0.5)
    began_s = time.monotonic()
    left, right = Device(10, began_s=began_s), Device(10, 0.05, began_s=began_s)
    frames = opened(live(left, right, max_skew_ms=20.0)).pairs()
    with pytest.raises(CameraError, match=r"ms apart, allowed are 20: synchronise"):
        next(frames)
    assert "pair dropped" in caplog.text


def calibration(size, **change):
    focal_px = 50.0 * size[0] / 64
    K = [[focal_px, 0, size[0] / 2], [0, focal_px, size[1] / 2], [0, 0, 1]]
    content = {"K_left": K, "K_right": K, "R": np.eye(3).tolist(), "t": [-0.1, 0, 0]}
    return {**content, "width": size[0], "height": size[1], **change}


def test_a_wrong_or_missing_calibration_stops_with_a_sentence_that_says_what_to_fix(
    opened, film, tmp_path, monkeypatch
):
    with pytest.raises(CalibrationError, match=r"no calibration: put .*--calibration FILE"):
        open_camera(film, "once")
    with pytest.raises(CalibrationError, match=r"there is no calibration .*x\.json"):
        open_camera(film, "once", tmp_path / "x.json")
    file = tmp_path / "stereo.json"
    file.write_text(json.dumps(calibration((1280, 720))))
    with pytest.raises(
        CalibrationError, match=r"gives 64x48, the calibration is for 1280x720.*--si"
    ):
        open_camera(film, "once")
    file.write_text(json.dumps(calibration((64, 48))))
    frame = next(opened(open_camera(film, "once")).frames())
    assert frame.image.shape == (48, 64, 3)
    device = Device(size=(128, 48))
    monkeypatch.setattr(
        "fleetpose.robot_agent.cameras.stereo.matching.open_pairs", lambda *_: opened(live(device))
    )
    with pytest.raises(CalibrationError, match="video0 needs its calibration: give --calibration"):
        open_camera("0", "once")


def camchain(**change):
    """As Kalibr writes it."""
    cameras = {
        name: {
            "cam_overlaps": [1 - k],
            "camera_model": "pinhole",
            "distortion_coeffs": [-0.28340811217029355, 0.07395907389290132 + k, 2e-4, 1.76e-05],
            "distortion_model": "radtan",
            "intrinsics": [458.654 + k, 457.296, 367.215, 248.375],
            "resolution": [752, 480],
            "rostopic": f"/cam{k}/image_raw",
        }
        for k, name in enumerate(("cam0", "cam1"))
    }
    T = np.eye(4)
    T[:3, :3] = [
        [0.99999726, -0.0023, 0.0004],
        [0.0023, 0.9999, 0.0141],
        [-0.0004, -0.0141, 0.9999],
    ]
    T[:3, 3] = (-0.1100739988, -0.0002127766, 0.0008097633)
    cameras["cam1"]["T_cn_cnm1"] = T.tolist()
    cameras["cam1"].update(change)
    return cameras


def write_camchain(path, cameras, head=""):
    path.write_text(head + yaml.safe_dump(cameras, default_flow_style=None))
    return path


@pytest.mark.parametrize("head", ["", "%YAML:1.0\n"])
def test_a_camchain_is_read_as_it_stands(tmp_path, head):
    cameras = camchain()
    rig = pairs_rig(write_camchain(tmp_path / "camchain.yaml", cameras, head))
    np.testing.assert_allclose(
        rig.K_left, [[458.654, 0, 367.215], [0, 457.296, 248.375], [0, 0, 1]]
    )
    assert rig.K_right[0, 0] == 459.654
    np.testing.assert_allclose(rig.D_right, cameras["cam1"]["distortion_coeffs"])
    np.testing.assert_allclose(rig.T_right_left, cameras["cam1"]["T_cn_cnm1"])
    assert rig.size == (752, 480)


def test_a_camchain_whose_second_camera_is_the_left_one_is_turned_round(tmp_path):
    T = np.linalg.inv(np.array(camchain()["cam1"]["T_cn_cnm1"]))
    rig = pairs_rig(write_camchain(tmp_path / "camchain.yaml", camchain(T_cn_cnm1=T.tolist())))
    assert rig.K_left[0, 0] == 459.654
    np.testing.assert_allclose(rig.T_right_left, np.linalg.inv(T), atol=1e-12)


def pairs_rig(path):
    from fleetpose.robot_agent.cameras.calibrations.reading import read_rig

    return read_rig(path.parent)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"distortion_model": "equidistant"}, "one eye is a fisheye"),
        ({"distortion_model": "fov"}, "'fov' is not supported.*pinhole-radtan"),
        ({"camera_model": "omni"}, "'omni' is not supported"),
        ({"T_cn_cnm1": [1, 2]}, "T_cn_cnm1 needs 16 numbers, it has 2"),
        ({"intrinsics": ["a", 1, 2, 3]}, "intrinsics holds no numbers"),
        ({"resolution": [640, 480]}, "the same resolution"),
    ],
)
def test_a_camchain_that_is_not_supported_is_refused_and_says_why(tmp_path, change, says):
    with pytest.raises(CalibrationError, match=says):
        pairs_rig(write_camchain(tmp_path / "camchain.yaml", camchain(**change)))
    one = {"cam0": camchain()["cam0"]}
    with pytest.raises(CalibrationError, match="1 cameras"):
        pairs_rig(write_camchain(tmp_path / "camchain.yaml", one))
    (tmp_path / "camchain.yaml").write_text("cam0: [\ncam1: {")
    with pytest.raises(CalibrationError, match="cannot be read as YAML"):
        pairs_rig(tmp_path / "camchain.yaml")
