"""The synthetic world: stereo measures its true depth, and robots are told no pose."""

import json
import socket
import threading

import numpy as np
import pytest

from fleetpose.evaluation.simulate.world.ring import RingWorld
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH
from fleetpose.evaluation.simulate.world_server import WorldServer, write_truth
from fleetpose.protocol.errors import UnreachableError
from fleetpose.robot_agent.cameras.base import DisparityImage
from fleetpose.robot_agent.cameras.stereo.matching import StereoMatcher
from fleetpose.robot_agent.cameras.synthetic import mount, open_camera


@pytest.fixture(scope="module")
def world() -> RingWorld:
    return RingWorld(3, separation_deg=30.0)


@pytest.fixture
def served(world):
    server = WorldServer(("127.0.0.1", 0), world, None)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        yield server.server_address[1]
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def test_stereo_measures_the_true_depth_to_one_percent(world):
    shot = world.shoot("r1")
    frame = StereoMatcher(world.rig).frame(shot.left, shot.right, 0)
    assert isinstance(frame.ranges, DisparityImage)
    measured = frame.ranges.focal_baseline_px_m / frame.ranges.disparity_px
    true = world.scene.render(shot.T_world_robot @ mount(), world.rig.K_left, (WIDTH, HEIGHT)).depth
    both = np.isfinite(measured) & (frame.ranges.disparity_px > 0) & np.isfinite(true) & (true > 0)
    assert both.mean() > 0.4
    assert np.median(np.abs(measured - true)[both] / true[both]) < 0.01


def test_every_exposure_has_its_own_noise_and_the_same_world_is_made_again(world):
    again = RingWorld(3, separation_deg=30.0)
    a, b = again.shoot("r2").left, again.shoot("r2").left
    assert np.abs(a.astype(int) - b).mean() > 0.5
    assert np.allclose(world.T_world_robot("r2"), again.T_world_robot("r2"))
    assert np.abs(world.shoot("r2").left.astype(int) - a).mean() < 5


def test_neighbours_stand_at_the_separation_asked_for(world):
    positions = [world.T_world_robot(name)[:2, 3] for name in world.names]
    angles = np.degrees([np.arctan2(y, x) for x, y in positions])
    assert np.allclose(np.diff(angles), 30.0)
    assert np.allclose(np.linalg.norm(positions, axis=1), world.radius_m)


def test_a_robot_gets_frames_and_a_rig_but_no_pose(served):
    with socket.create_connection(("127.0.0.1", served), timeout=10) as connection:
        connection.sendall(json.dumps({"robot": "r2"}).encode() + b"\n")
        told = json.loads(connection.makefile("rb").readline())
    assert set(told) == {"K_left", "D_left", "K_right", "D_right", "R", "t", "width", "height"}
    camera = open_camera(f"127.0.0.1:{served}/r2", "once")
    try:
        frame = next(camera.frames())
    finally:
        camera.close()
    assert frame.image.shape == (HEIGHT, WIDTH, 3)
    assert frame.model.noise.focal_baseline_px_m is not None


def test_an_unknown_robot_is_told_so_and_others_go_on(served):
    with pytest.raises(UnreachableError, match="r9"):
        open_camera(f"127.0.0.1:{served}/r9", "once")
    open_camera(f"127.0.0.1:{served}/r1", "once").close()


@pytest.mark.parametrize(
    "request_line", [b"garbage", b"[]", b'{"robot": ["r1"]}', b"\xff\xfe", b"[" * 4000]
)
def test_a_bad_request_is_answered_with_an_error(served, request_line):
    with socket.create_connection(("127.0.0.1", served), timeout=10) as connection:
        connection.sendall(request_line + b"\n")
        assert "no robot" in json.loads(connection.makefile("rb").readline())["error"]


def test_a_camera_whose_world_has_gone_says_so(world):
    server = WorldServer(("127.0.0.1", 0), world, None)
    thread = threading.Thread(target=server.handle_request)
    thread.start()
    camera = open_camera(f"127.0.0.1:{server.server_address[1]}/r1", "once")
    try:
        thread.join()
        server.server_close()
        camera._link._socket.shutdown(socket.SHUT_RDWR)
        with pytest.raises(UnreachableError, match="has gone"):
            next(camera.frames())
    finally:
        camera.close()


def test_the_truth_file_is_whole_and_holds_all_robots(world, tmp_path):
    write_truth(world, tmp_path / "truth")
    truth = json.loads((tmp_path / "truth").read_text())
    assert truth["radius_m"] == world.radius_m
    assert set(truth["T_world_robots"]) == set(world.names)
    assert [file.name for file in tmp_path.iterdir()] == ["truth"]
