"""Stereo against rendered scenes whose depth is known exactly; calibrations good and bad."""

import json

import cv2
import numpy as np
import pytest

from fleetpose.evaluation.simulate.world.materials.textures import noise
from fleetpose.evaluation.simulate.world.render import Quad, Renderer
from fleetpose.protocol.errors import CalibrationError, DataFolderError
from fleetpose.robot_agent.cameras.calibrations.reading import read_rig, rig_of
from fleetpose.robot_agent.cameras.stereo.matching import (
    DISPARITY_SIGMA_PX,
    StereoMatcher,
    open_camera,
)
from fleetpose.robot_agent.cameras.stereo.rig import StereoRig, content_of

WIDTH, HEIGHT = SIZE = (480, 360)
K = np.array(((400.0, 0, 239.5), (0, 400.0, 179.5), (0, 0, 1)))
BASELINE_M = 0.4
WALL_M, PANEL_M = 9.0, 3.5
LEAN = 0.3  # metres of depth per metre to the right: squarely seen, matches snap to whole pixels


@pytest.fixture(scope="module")
def scene() -> Renderer:
    """A wall with a panel before it, to the left of the middle; a camera stands at the
    origin.
    """
    rng = np.random.default_rng(0)
    wall = panel_of(rng, (-16, -12, WALL_M - 16 * LEAN), (32, 24), LEAN)
    return Renderer([wall, panel_of(rng, (-1.1, -1, PANEL_M), (1.0, 2))], np.zeros((4, 8, 3)))


def panel_of(rng, corner, size, lean=0.0) -> Quad:
    """A panel before the camera, top left corner and size in metres."""
    grey = np.clip(128 + 45 * noise(rng, size[1] * 50, round(size[0] * 50), 40, 5, 0.8), 0, 255)
    texture = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    right, down = np.array((size[0], 0.0, size[0] * lean)), np.array((0.0, size[1], 0.0))
    return Quad(np.array(corner, float), right, down, texture)


def sideways(rotation=(0.0, 0.0, 0.0)) -> np.ndarray:
    """T_right_left of a right camera that sits one baseline to the right, turned by a vector."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array(rotation))[0]
    T[:3, 3] = T[:3, :3] @ (-BASELINE_M, 0.0, 0.0)
    return T


def rectified_rig() -> StereoRig:
    return StereoRig(K, np.zeros(5), K, np.zeros(5), sideways(), SIZE)


def crooked_rig() -> StereoRig:
    """Cameras that differ in everything: focal length, centre, distortion, direction."""
    K_right = K * ((0.98, 1, 1.03), (1, 0.98, 0.97), (1, 1, 1))
    D_left, D_right = (
        np.array((-0.2, 0.06, 1e-3, -8e-4, 0)),
        np.array((-0.17, 0.04, -5e-4, 1e-3, 0)),
    )
    return StereoRig(K, D_left, K_right, D_right, sideways((0.02, -0.03, 0.015)), SIZE)


def shot(scene, rig, seed=0):
    """What both cameras see, lens and noise included; the left one stands at the origin."""
    rng = np.random.default_rng(seed)
    eyes = (
        (rig.K_left, rig.D_left, np.eye(4)),
        (rig.K_right, rig.D_right, np.linalg.inv(rig.T_right_left)),
    )
    for K_eye, D, T_world_eye in eyes:
        image = through_lens(scene, T_world_eye, K_eye, D) + rng.normal(0, 1.5, (HEIGHT, WIDTH, 3))
        yield np.clip(np.rint(image), 0, 255).astype(np.uint8)


def through_lens(scene, T_world_eye, K_eye, D):
    """A distorted image: an ideal one, larger and finer, looked up where each pixel's ray goes."""
    if not D.any():
        return scene.image(T_world_eye, K_eye, SIZE)
    fine = np.array(((800.0, 0, 799.5), (0, 800.0, 599.5), (0, 0, 1)))
    ideal = scene.image(T_world_eye, fine, (1600, 1200), samples=1)
    pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).reshape(-1, 1, 2)
    places = cv2.undistortPoints(pixels.astype(np.float64), K_eye, D, P=fine)
    return cv2.remap(
        ideal, places.reshape(HEIGHT, WIDTH, 2).astype(np.float32), None, cv2.INTER_AREA
    )


def depth_of(frame):
    return frame.ranges.focal_baseline_px_m / frame.ranges.disparity_px


def true_depth(scene, frame, rig):
    """Exact depth on the frame's grid, from where the rig says that its rectified camera is."""
    T_left_rectified = np.linalg.inv(rig.T_robot_left) @ frame.model.T_robot_camera
    return scene.depth(T_left_rectified, frame.model.K, SIZE)


@pytest.mark.parametrize("rig", [rectified_rig(), crooked_rig()], ids=["rectified", "crooked"])
def test_depth_is_that_of_the_scene_and_as_sure_as_it_says(scene, rig):
    frame = StereoMatcher(rig).frame(*shot(scene, rig), stamp_ns=7)
    measured, true = depth_of(frame), true_depth(scene, frame, rig)
    seen = np.isfinite(measured)
    assert frame.stamp_ns == 7
    assert seen.mean() > 0.8
    assert np.median(np.abs(measured - true)[seen] / true[seen]) < 0.01
    wrong_by = frame.ranges.disparity_px - frame.ranges.focal_baseline_px_m / true
    sigma = 1.4826 * np.median(np.abs(wrong_by[seen]))
    assert 0.02 < sigma < DISPARITY_SIGMA_PX
    assert (np.abs(wrong_by[seen]) < 3 * DISPARITY_SIGMA_PX).mean() > 0.95
    assert 0.0 < (measured[seen] < 6).mean() < 0.3  # the panel is nearer than the wall


def test_what_stands_still_is_matched_once(scene):
    rig = rectified_rig()
    matcher = StereoMatcher(rig)
    first = matcher.frame(*shot(scene, rig, seed=1), stamp_ns=1)
    again = matcher.frame(*shot(scene, rig, seed=2), stamp_ns=2)
    assert again.ranges is first.ranges and again.stamp_ns == 2
    left, right = shot(scene, rig, seed=3)
    other = matcher.frame(left, np.roll(right, 1, axis=1), stamp_ns=3)
    assert other.ranges is not first.ranges
    back = matcher.frame(left, right, stamp_ns=4)
    assert back.ranges is not other.ranges


def test_the_rectified_image_is_what_a_pinhole_camera_sees_there(scene):
    rig = crooked_rig()
    frame = StereoMatcher(rig).frame(*shot(scene, rig), stamp_ns=0)
    T_left_rectified = np.linalg.inv(rig.T_robot_left) @ frame.model.T_robot_camera
    ideal = scene.image(T_left_rectified, frame.model.K, SIZE)
    here = np.abs(frame.image.astype(int) - ideal)
    assert np.median(here) < 5 < np.median(np.abs(np.roll(frame.image, 2, 1).astype(int) - ideal))


def test_what_only_one_eye_sees_gets_no_depth(scene):
    rig = rectified_rig()
    left, right = (cv2.cvtColor(eye, cv2.COLOR_BGR2GRAY) for eye in shot(scene, rig))
    z_left = scene.depth(np.eye(4), K, SIZE)
    z_right = scene.depth(np.linalg.inv(rig.T_right_left), K, SIZE)
    columns = np.rint(np.arange(WIDTH) - K[0, 0] * BASELINE_M / z_left).astype(int)
    elsewhere = np.take_along_axis(z_right, np.maximum(columns, 0), axis=1)
    hidden = (columns >= 0) & (elsewhere < z_left - 1)
    hidden = cv2.erode(hidden.astype(np.uint8), np.ones((1, 5))) > 0  # edges blur by the block
    assert hidden.sum() > 1000
    matcher = StereoMatcher(rig)
    kept, claimed = (
        np.isfinite(matcher.disparity(left, right, left_right_check=check))[hidden].mean()
        for check in (True, False)
    )
    assert kept < 0.02
    assert kept < claimed / 2


def test_a_surface_without_texture_gets_no_depth():
    blank = np.full((HEIGHT, WIDTH, 3), 128.0)
    noisy = (blank + np.random.default_rng(k).normal(0, 1.5, blank.shape) for k in range(2))
    left, right = (eye.astype(np.uint8) for eye in noisy)
    frame = StereoMatcher(rectified_rig()).frame(left, right, 0)
    assert np.isfinite(frame.ranges.disparity_px).mean() < 0.01


def test_grey_images_give_the_same_ranges_as_coloured_ones(scene):
    rig = rectified_rig()
    eyes = [cv2.cvtColor(eye, cv2.COLOR_BGR2GRAY) for eye in shot(scene, rig)]
    grey = StereoMatcher(rig).frame(*eyes, stamp_ns=0)
    colour = StereoMatcher(rig).frame(*(cv2.cvtColor(e, cv2.COLOR_GRAY2BGR) for e in eyes), 0)
    assert grey.image.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(grey.ranges.disparity_px, colour.ranges.disparity_px)


def test_images_of_another_size_are_refused_with_both_sizes():
    image = np.zeros((100, 200, 3), np.uint8)
    with pytest.raises(CalibrationError, match=r"200x100 .* 480x360"):
        StereoMatcher(rectified_rig()).frame(image, image, 0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"t": [-400.0, 0, 0]}, "millimetres"),
        ({"t": [0.4, 0, 0]}, "swap"),
        ({"t": [0, 0, -0.4]}, "sideways"),
        ({"t": [0, 0.4, 0]}, "upper one"),
        ({"t": [0.0, 0, 0]}, "zero"),
        ({"t": [[-0.4, 0], [0, 0]]}, "t needs 3 numbers|T needs 3 numbers"),
        ({"t": None}, "lacks t"),
        ({"K_left": None}, "lacks K_left"),
        ({"K_right": [[0.0, 0, 240], [0, 400, 180], [0, 0, 1]]}, "K_right is no pinhole"),
        ({"K_left": [[400.0, 0, 900], [0, 400, 180], [0, 0, 1]]}, "480x360"),
        ({"D_left": [0.1, 0.2, 0.3]}, "D_left has 3 numbers"),
        ({"R": [[1.0, 0, 0], [0, 2, 0], [0, 0, 1]]}, "orthonormal"),
    ],
)
def test_an_impossible_calibration_is_refused_and_says_what_to_fix(change, says):
    content = {k: v for k, v in (content_of(rectified_rig()) | change).items() if v is not None}
    with pytest.raises(CalibrationError, match=says):
        rig_of(content, "here")


def test_a_rig_is_the_same_from_json_and_from_opencv_files(tmp_path):
    rig = crooked_rig()
    (tmp_path / "json").mkdir()
    (tmp_path / "json" / "stereo.json").write_text(json.dumps(content_of(rig)))
    names = {"M1": rig.K_left, "D1": rig.D_left, "M2": rig.K_right, "D2": rig.D_right}
    write_opencv(tmp_path / "yml" / "intrinsics.yml", names)
    pose = {"R": rig.T_right_left[:3, :3], "T": rig.T_right_left[:3, 3:]}
    write_opencv(tmp_path / "yml" / "extrinsics.yml", pose)
    write_opencv(tmp_path / "xml" / "stereo.xml", names | pose)
    for folder in ("json", "yml", "xml"):
        read = read_rig(tmp_path / folder, SIZE)
        assert read.size == rig.size
        for name in ("K_left", "D_left", "K_right", "D_right", "T_right_left"):
            np.testing.assert_allclose(getattr(read, name), getattr(rig, name), atol=1e-12)


def write_opencv(path, matrices):
    path.parent.mkdir(exist_ok=True)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, matrix in matrices.items():
        storage.write(name, matrix.reshape(len(matrix), -1))
    storage.release()


def recording(folder, scene, pairs=2):
    for side in ("left", "right"):
        (folder / side).mkdir()
    for k in range(pairs):
        for side, image in zip(("left", "right"), shot(scene, rectified_rig(), k), strict=True):
            cv2.imwrite(str(folder / side / f"{k:03d}.png"), image)
    (folder / "stereo.json").write_text(json.dumps(content_of(rectified_rig())))
    return folder


def test_a_recording_is_played_in_order_with_depth(scene, tmp_path):
    camera = open_camera(str(recording(tmp_path, scene)), "once")
    frames = list(camera.frames())
    camera.close()
    assert len(frames) == 2
    for k, frame in enumerate(frames):
        left = cv2.imread(str(tmp_path / "left" / f"{k:03d}.png"))
        np.testing.assert_array_equal(frame.image, left)
        true = true_depth(scene, frame, rectified_rig())
        assert np.nanmedian(np.abs(depth_of(frame) - true) / true) < 0.01
    assert frames[0].stamp_ns < frames[1].stamp_ns


def test_a_recording_that_lacks_something_says_what(scene, tmp_path):
    folder = recording(tmp_path, scene, pairs=1)
    (folder / "stereo.json").write_text("{ no json")
    with pytest.raises(CalibrationError, match=r"stereo\.json"):
        open_camera(str(folder), "once")
    (folder / "stereo.json").unlink()
    with pytest.raises(CalibrationError, match=r"stereo\.json.*there"):
        open_camera(str(folder), "once")
    (folder / "right" / "000.png").rename(folder / "left" / "001.png")
    with pytest.raises(DataFolderError, match="right"):
        open_camera(str(folder), "once")
