"""Where up is, of a camera that is tilted on a robot that leans: known, and told by each source."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fleetpose.robot_agent.cameras.bag.camera import open_camera
from fleetpose.robot_agent.cameras.bag.options import BagOptions
from tests.rosmsg import bag_makers as makers

FRAME = "optical"
Z = np.array((0.0, 0.0, 1.0))


def turned(*angles_deg):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    return T


T_ODOM_BASE = turned(7, -4, 130)  # the robot leans
T_BASE_OPTICAL = turned(0, 20, 0) @ makers.T_LINK_OPTICAL  # its camera looks down
T_BASE_IMU = turned(180, 0, 90)
UP_CAMERA = (T_ODOM_BASE @ T_BASE_OPTICAL)[:3, :3].T @ Z


def write(path, odometry=T_ODOM_BASE, shake=0.0, imu=True, static=True, info=None):
    """Three frames, with an Imu at 100 Hz and the robot's pose in tf as well."""
    made, rng = makers.source(3), np.random.default_rng(0)
    felt = 9.81 * (T_ODOM_BASE @ T_BASE_IMU)[:3, :3].T @ Z
    with makers.Maker(path) as bag:
        for k, (bgr, mm) in enumerate(zip(made.colours, made.depths, strict=True)):
            at_ns = makers.BEGIN_NS + k * makers.PERIOD_NS
            for n in range(10) if imu else ():
                noise = rng.normal(0, 0.05, 3) + shake * (-1) ** n * np.eye(3)[0]
                bag.put("/imu", bag.imu(felt + noise, at_ns + n * 10**7, "imu"), at_ns + n * 10**7)
            bag.put("/odom", bag.odometry(at_ns, odometry, np.eye(6) * 1e-4), at_ns)
            bag.put("/tf", bag.transforms(at_ns, ("map", "base_link", T_ODOM_BASE)), at_ns)
            if static and not k:
                edges = (("base_link", FRAME, T_BASE_OPTICAL), ("base_link", "imu", T_BASE_IMU))
                bag.put("/tf_static", bag.transforms(at_ns, *edges), at_ns)
            bag.put("/color/camera_info", bag.info(at_ns, FRAME, **(info or {})), at_ns)
            bag.put("/color/image_raw", bag.image(bgr, "bgr8", at_ns, FRAME), at_ns)
            bag.put("/depth/image_raw", bag.image(mm, "16UC1", at_ns, FRAME), at_ns)
    return path


def ups(path, **options):
    camera = open_camera(str(path), "once", bag=BagOptions(speed=None, **options))
    try:
        return [frame.up_camera for frame in camera.frames()]
    finally:
        camera.close()


def off_deg(up, true=UP_CAMERA):
    return np.degrees(np.arccos(np.clip(up @ true, -1, 1)))


@pytest.mark.parametrize("source", ["odom", "imu", "tf", "auto"])
def test_each_source_gives_up_in_the_cameras_axes(source, tmp_path):
    found = ups(write(tmp_path / "bag"), up=source)
    assert len(found) == 3
    for up in found:
        assert np.linalg.norm(up) == pytest.approx(1) and off_deg(up) < 1.0


def test_up_is_in_the_axes_of_the_rectified_image(tmp_path):
    R = turned(0, 0, 9)[:3, :3]
    for up in ups(write(tmp_path / "bag", info={"R": R}), up="odom"):
        assert off_deg(up, R @ UP_CAMERA) < 1e-3


def test_nothing_is_told_without_a_source_or_when_not_asked_for(tmp_path):
    assert ups(write(tmp_path / "bag"), up="none") == [None] * 3
    bare = write(tmp_path / "bare", static=False)
    for source in ("odom", "imu"):
        assert ups(bare, up=source) == [None] * 3, "nothing joins the camera to what is told"


def test_an_accelerometer_that_is_shaken_is_not_asked_but_odometry_is(tmp_path):
    path = write(tmp_path / "bag", shake=3.0)
    assert ups(path, up="imu") == [None] * 3
    assert all(off_deg(up) < 1e-3 for up in ups(path))


def test_odometry_that_is_not_level_is_found_out(tmp_path, caplog):
    askew = turned(0, -30, 0) @ T_ODOM_BASE
    path = write(tmp_path / "bag", odometry=askew)
    assert all(off_deg(up) < 1.0 for up in ups(path))
    assert "its accelerometer says otherwise by 30 deg" in caplog.text
    of_a_camera = write(tmp_path / "camera", odometry=turned(-90, 0, 0), imu=False)
    assert ups(of_a_camera) == [None] * 3 and "the robot leans by 90 deg" in caplog.text
    assert all(up is not None for up in ups(of_a_camera, up="odom")), "who asks for it gets it"
