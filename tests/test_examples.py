"""Every example runs, and what it prints is true."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.simulate.world import RingWorld
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH
from fleetpose.protocol.transport import wait_until
from fleetpose.robot_agent.cameras.synthetic import mount

EXAMPLES = Path(__file__).parent.parent / "examples"
RADIUS_M = 10.0
DEPTH_SIGMA = 0.001  # times the depth squared, metres: what the examples state
MOST_LINES = 40
WITHIN_S = 120.0  # workers of a machine that compiles the inner loops first come late


@pytest.fixture(scope="module")
def views(tmp_path_factory):
    """Files of what two robots 20 deg apart see, and where camera b is in camera a."""
    folder = tmp_path_factory.mktemp("views")
    world, rng = RingWorld(2, separation_deg=20.0, radius_m=RADIUS_M), np.random.default_rng(0)
    poses = []
    for name in ("r1", "r2"):
        shot = world.shoot(name)
        poses.append(shot.T_world_robot @ mount())
        depth_m = world.scene.depth(poses[-1], world.rig.K_left, (WIDTH, HEIGHT))
        depth_m = depth_m + DEPTH_SIGMA * depth_m**2 * rng.normal(size=depth_m.shape)
        np.savez(
            folder / f"{name}.npz",
            image=shot.left,
            depth_m=np.where(depth_m < 30.0, depth_m, np.nan).astype(np.float32),
            K=world.rig.K_left,
        )
    return folder, np.linalg.inv(poses[0]) @ poses[1]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A router and a server; what a test starts of examples ends with them."""
    with LocalFleet(tmp_path_factory.mktemp("fleet")) as running:
        running.start_router()
        running.start_server("--workers", "2")
        yield running


@pytest.fixture
def start(fleet):
    """Starts an example that runs until it is ended; returns what reads its lines."""
    running = []

    def run(example, *arguments):
        log = fleet.directory / f"{example}-{len(running)}.txt"
        with log.open("w") as out:
            command = [sys.executable, "-P", EXAMPLES / example, *arguments, fleet.endpoint]
            running.append(subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT))
        return lambda: log.read_text().splitlines()

    yield run
    for process in running:
        process.kill()
        process.wait()


def run(example, *arguments) -> list[str]:
    """The lines of an example that ends by itself."""
    command = [sys.executable, "-P", str(EXAMPLES / example), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=150)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_two_views_are_aligned_by_the_library_alone(views):
    folder, T_a_b = views
    verdict, *matrix = run("align_two_views.py", folder / "r1.npz", folder / "r2.npz")
    assert verdict.startswith("verified")
    found = np.array([line.replace("[", " ").replace("]", " ").split() for line in matrix], float)
    assert np.linalg.norm(found[:3, 3] - T_a_b[:3, 3]) < 0.02 * RADIUS_M
    assert np.abs(found[:3, :3] - T_a_b[:3, :3]).max() < 0.02


def places(lines) -> dict[str, np.ndarray]:
    """Where robots were last told to be."""
    told = [line.split() for line in lines if "+-" in line]
    return {name: np.array((x, y, z), float) for name, x, y, z, *_ in told}


@pytest.mark.timeout(300)
def test_pushed_frames_become_poses_that_another_program_follows(views, start, fleet):
    folder, T_a_b = views
    said = [start("push_frames.py", name, folder / f"{name}.npz") for name in ("r1", "r2")]
    follower = start("follow_poses.py")

    def all_located() -> bool:
        fleet.check()
        return all(any(line.startswith("located [[") for line in lines()) for lines in said)

    assert wait_until(all_located, WITHIN_S), [lines()[-3:] for lines in said]
    assert wait_until(lambda: {"r1", "r2"} <= set(places(follower())), WITHIN_S), follower()[-9:]
    now = places(follower())
    apart_m = np.linalg.norm(now["r1"] - now["r2"])
    assert apart_m == pytest.approx(np.linalg.norm(T_a_b[:3, 3]), abs=0.02 * RADIUS_M)


@pytest.mark.timeout(300)
def test_clicks_between_cameras_of_ones_own_are_accepted(start, fleet):
    cameras = [start("own_camera.py", "w1", "0.0"), start("own_camera.py", "w2", "1.0")]
    follower = start("follow_poses.py")

    def both_there() -> bool:
        fleet.check()
        return {"w1", "w2"} <= {line.partition(" ")[0] for line in follower()}

    assert wait_until(both_there, WITHIN_S), [lines()[-3:] for lines in cameras]
    right = ("200,60,100,60", "280,180,180,180", "150,200,50,200")  # a metre is 100 px
    off_the_image = "300,120,900,120"
    told = run("click.py", fleet.endpoint, "w1", "w2", *right, off_the_image)
    assert told[:3] == [f"{point} accepted" for point in right]
    assert told[3].startswith(off_the_image) and "accepted" not in told[3]


@pytest.mark.parametrize("example", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
def test_an_example_is_short(example):
    assert len(example.read_text().splitlines()) <= MOST_LINES
