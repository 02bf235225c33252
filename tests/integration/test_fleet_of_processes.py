"""Real processes over real zenoh in the synthetic world: frames to poses, a click to a changed
pose.
"""

import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.fleet import open_link, plan_world, start
from fleetpose.evaluation.system.observer import Observer
from fleetpose.pose_server.persistence.graph_store import read_graph
from fleetpose.pose_server.persistence.restore import GRAPH
from fleetpose.protocol.codec import unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import PairCorrespondences, RobotPose
from fleetpose.protocol.transport import wait_until

RADIUS_M = 10.0
FIRST_POSE_S = 60.0
CLICK_S = 60.0
CLICKS = 6  # a pixel beside a depth edge lifts to another surface: a few may be wrong


@contextmanager
def running(folder: Path, robots: int, skip: str = "") -> Iterator[tuple[LocalFleet, Observer]]:
    plan = plan_world([f"r{k + 1}" for k in range(robots)], folder, moving=False, seed=0)
    skip_file = None
    if skip:
        skip_file = folder / "skip.txt"
        skip_file.write_text(skip)
    with LocalFleet(folder) as fleet:
        start(fleet, plan, 2, folder / "state", skip_file)
        link = open_link(fleet)
        try:
            yield fleet, Observer(link, Keys(fleet.site))
        finally:
            link.close()


def pose(observer: Observer, robot: str) -> RobotPose | None:
    seen = observer.poses().get(robot)
    return None if seen is None else seen.pose


def error_m(observer: Observer, folder: Path, a: str, b: str) -> float:
    """How far the position of b as seen from a is from the truth."""
    T_a, T_b = pose(observer, a).T_fleet_robot, pose(observer, b).T_fleet_robot
    G_a, G_b = (truth_of(folder, robot) for robot in (a, b))
    found, true = np.linalg.inv(T_a) @ T_b, np.linalg.inv(G_a) @ G_b
    return float(np.linalg.norm(found[:3, 3] - true[:3, 3]))


def truth_of(folder: Path, robot: str) -> np.ndarray:
    import json

    return np.array(json.loads((folder / "truth").read_text())["T_world_robots"][robot])


def joined(observer: Observer, a: str, b: str) -> bool:
    at_a, at_b = pose(observer, a), pose(observer, b)
    return at_a is not None and at_b is not None and at_a.component == at_b.component


@pytest.mark.timeout(180)
def test_frames_become_poses_of_the_whole_fleet(tmp_path):
    with running(tmp_path, 3) as (fleet, observer):
        names = ("r1", "r2", "r3")

        def all_located() -> bool:
            fleet.check()
            return all((p := pose(observer, name)) is not None and p.located for name in names)

        assert wait_until(all_located, FIRST_POSE_S), fleet.tail("server")
        for name in ("r2", "r3"):
            assert error_m(observer, tmp_path, "r1", name) < 0.02 * RADIUS_M
    assert fleet.leftover_processes() == 0


@pytest.mark.timeout(180)
def test_a_killed_server_has_its_graph_again_and_aligns_no_robots_anew(tmp_path):
    names = ("r1", "r2", "r3")
    with running(tmp_path, 3) as (fleet, observer):

        def all_located(but: str = "") -> bool:
            fleet.check()
            poses = [pose(observer, name) for name in names]
            return all(p is not None and p.located and p.server_epoch != but for p in poses)

        def is_kept() -> bool:
            graph = read_graph(tmp_path / "state" / GRAPH)
            between = {frozenset((e.a.robot, e.b.robot)) for e in graph.edges.values()}
            return len(between) >= 2 and graph.gauge is not None

        assert wait_until(lambda: all_located() and is_kept(), FIRST_POSE_S), fleet.tail("server")
        assert mapped(tmp_path) == names  # while it runs
        epoch, before = pose(observer, "r2").server_epoch, pose(observer, "r3").T_fleet_robot
        fleet.kill("server")
        nobody = tmp_path / "nobody.txt"  # no pair is aligned by itself any more
        nobody.write_text("r1 r2\nr1 r3\nr2 r3\n")
        options = ("--workers", "2", "--skip-pairs", str(nobody))
        fleet.start_server(*options, state=tmp_path / "state")
        assert wait_until(lambda: all_located(but=epoch), FIRST_POSE_S), fleet.tail("server")
        shift = pose(observer, "r3").T_fleet_robot[:3, 3] - before[:3, 3]
        assert np.linalg.norm(shift) < 0.01 * RADIUS_M
        assert pose(observer, "r1").gauge_revision == pose(observer, "r3").gauge_revision


def mapped(folder: Path) -> tuple[str, ...]:
    """Whom the map of the session shows that the server keeps."""
    cloud, picture = folder / "map.ply", folder / "map.png"
    options = ("--state-dir", str(folder / "state"), "--map", str(cloud), "--picture", str(picture))
    command = [sys.executable, "-P", "-m", "fleetpose.pose_server", "export", *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    assert picture.read_bytes().startswith(b"\x89PNG")
    header = cloud.read_bytes().partition(b"end_header\n")[0].decode().splitlines()
    assert int(next(line for line in header if "element vertex" in line).split()[-1]) > 10_000
    return tuple(line.split()[-1] for line in header if line.startswith("comment robot"))


@pytest.mark.timeout(240)
def test_clicks_join_a_skipped_pair_and_survive_a_killed_server(tmp_path):
    with running(tmp_path, 2, skip="r1 r2\n") as (fleet, observer):
        assert wait_until(lambda: pose(observer, "r1") and pose(observer, "r2"), FIRST_POSE_S)
        assert not joined(observer, "r1", "r2")

        added = put(fleet, true_clicks(observer, tmp_path, fleet))
        assert added.returncode == 0, added.stdout + added.stderr
        assert wait_until(lambda: joined(observer, "r1", "r2"), CLICK_S), fleet.tail("server")
        assert error_m(observer, tmp_path, "r1", "r2") < 0.05 * RADIUS_M

        fleet.kill("server")
        fleet.restart("server")
        kept: list[PairCorrespondences] = []
        link = open_link(fleet)
        link.on_latched(
            Keys(fleet.site).correspondences("r1", "r2"),
            lambda sample: kept.append(unpack(PairCorrespondences, sample.payload)),
        )
        try:
            epoch = pose(observer, "r2").server_epoch
            assert wait_until(
                lambda: (
                    pose(observer, "r2").server_epoch != epoch
                    and pose(observer, "r1").server_epoch != epoch
                    and joined(observer, "r1", "r2")
                ),
                FIRST_POSE_S,
            ), fleet.tail("server")
            assert wait_until(lambda: kept and len(kept[-1].items) == CLICKS, CLICK_S)
        finally:
            link.close()


def min_distance(uv: np.ndarray) -> float:
    apart = np.linalg.norm(uv[:, None] - uv[None], axis=2)
    return float(apart[~np.eye(len(uv), dtype=bool)].min())


def true_clicks(observer: Observer, folder: Path, fleet: LocalFleet) -> list[str]:
    """Points far apart that both robots see, with a pixel of noise, as the command takes
    them.
    """
    from fleetpose.evaluation.system.truth import WorldTruth

    truth = WorldTruth(folder / "truth", {"r1": "r1", "r2": "r2"})
    views = [observer.view(pose(observer, robot).view) for robot in ("r1", "r2")]
    uv_i, uv_j = truth.correspondences(*views)
    rng = random.Random(0)
    samples = [rng.sample(range(len(uv_i)), CLICKS) for _ in range(300)]
    best = max(samples, key=lambda t: min_distance(uv_i[t]))
    noise = [rng.gauss(0, 0.7) for _ in range(4 * CLICKS)]
    return [
        ",".join(f"{value + noise[4 * k + n]:.1f}" for n, value in enumerate((*uv_i[t], *uv_j[t])))
        for k, t in enumerate(best)
    ]


def put(fleet: LocalFleet, clicks: list[str]) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable,
        "-P",
        "-m",
        "fleetpose.hmi_client",
        "correspondences",
        "add",
        "r1",
        "r2",
    ]
    return subprocess.run(
        [*command, *clicks, "--timeout", "10", *fleet.connection],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
