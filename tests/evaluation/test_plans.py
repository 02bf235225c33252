"""The plans that fool: alike places look alike to the last grey level, unique things tell them
apart, and the folders are recordings like any other.
"""

import random
import threading
from itertools import combinations
from typing import get_args

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from fleetpose.evaluation.bench.clicks.truth import true_depth, true_pixels
from fleetpose.evaluation.bench.pairs.worker import encode
from fleetpose.evaluation.bench.questions.play import Task, clicks_in
from fleetpose.evaluation.bench.synth import run
from fleetpose.evaluation.data.anonymize import strip
from fleetpose.evaluation.data.opening import open_recording, points_of
from fleetpose.evaluation.data.recording import CLOUD_KINDS, shared_tracks
from fleetpose.evaluation.metrics.geometry import inverse, transform
from fleetpose.evaluation.metrics.scoring import Limits
from fleetpose.evaluation.options.fleets import FleetOptions, SynthOptions, WorldOptions
from fleetpose.evaluation.options.names import PlanName
from fleetpose.evaluation.simulate.world import PLANS, PlanWorld
from fleetpose.evaluation.simulate.world.plans.planned import plan_named, stations
from fleetpose.evaluation.simulate.world.plans.things import unique_things
from fleetpose.evaluation.simulate.world.render import Renderer
from fleetpose.evaluation.simulate.world.robots import HEIGHT, WIDTH
from fleetpose.evaluation.simulate.world_server import WorldServer, world_of, write_truth
from fleetpose.evaluation.system.fleet import plan_fleet
from fleetpose.evaluation.system.truth import WorldTruth
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.cameras.synthetic import mount, open_camera

ROBOTS = 3
SYMMETRIC = sorted(set(PLANS) - {"weak"})


def image_at(world: PlanWorld, scene: Renderer, T_world_robot) -> np.ndarray:
    return scene.image(T_world_robot @ mount(), world.rig.K_left, (WIDTH, HEIGHT), samples=1)


def differing(a: np.ndarray, b: np.ndarray) -> float:
    """Share of the pixels that differ by more than rounding can do on a sharp texture."""
    return float((np.abs(a.astype(int) - b).max(-1) > 24).mean())


def seen_from_alike_places(
    scene: Renderer, world: PlanWorld, k: int, T
) -> tuple[np.ndarray, np.ndarray]:
    """What robot k sees, and what it would see at the alike place; a mirrored place is seen in a
    mirror.
    """
    T_world_robot = world.T_world_robot(k)
    here = image_at(world, scene, T_world_robot)
    if np.linalg.det(T[:3, :3]) > 0:
        return here, image_at(world, scene, T @ T_world_robot)
    left_and_right_exchanged = np.diag((1.0, -1.0, 1.0, 1.0))
    return here, image_at(world, scene, T @ T_world_robot @ left_and_right_exchanged)[:, ::-1]


@pytest.fixture(scope="module", params=SYMMETRIC)
def plain(request) -> PlanWorld:
    return PlanWorld(request.param, ROBOTS, unique=0, seed=3)


def test_alike_places_look_alike_where_nothing_unique_stands_about(plain):
    for T in plain.plan.symmetries[:3]:
        for k in range(ROBOTS):
            here, there = seen_from_alike_places(plain.scene, plain, k, T)
            assert differing(here, there) < 0.004


def test_another_place_looks_different(plain):
    """The comparison above can fail: half a metre aside is not alike."""
    aside = np.eye(4)
    aside[:2, 3] = 0.5, 0.3
    here, there = seen_from_alike_places(plain.scene, plain, 0, aside)
    assert differing(here, there) > 0.2


def test_many_unique_things_break_every_symmetry(plain):
    things = unique_things(plain.plan.fronts, 40, plain.plan.clear_m - 0.3, seed=3)
    broken = plain.scene.with_quads(things)
    for T in plain.plan.symmetries[:3]:
        pairs = [seen_from_alike_places(broken, plain, k, T) for k in range(ROBOTS)]
        assert max(differing(here, there) for here, there in pairs) > 0.02


def test_more_unique_things_leave_robots_textures_and_the_former_things():
    few, many = PlanWorld("facade", 4, 3, seed=1), PlanWorld("facade", 4, 12, seed=1)
    assert all(np.array_equal(few.T_world_robot(k), many.T_world_robot(k)) for k in range(4))
    few_quads, many_quads = few.scene._quads, many.scene._quads
    assert len(many_quads) > len(few_quads) > len(few.plan.quads)
    for a, b in zip(few_quads, many_quads[: len(few_quads)], strict=True):
        assert np.array_equal(a.texture, b.texture)
        assert np.array_equal(a.corner, b.corner)


@pytest.mark.parametrize("name", sorted(PLANS))
def test_robots_stand_where_there_is_room_and_look_at_something_near(name):
    world = PlanWorld(name, 6, unique=20, seed=5)
    near, far = world.plan.distance_m
    for k in range(6):
        T_world_robot = world.T_world_robot(k)
        place = T_world_robot[:2, 3]
        assert any(room.holds(place, world.plan.clear_m) for room in world.plan.rooms)
        depth = world.scene.depth(T_world_robot @ mount(), world.rig.K_left, (WIDTH, HEIGHT))
        assert 0.15 * near < np.nanmin(depth)
        assert 0.4 * near < np.nanmedian(depth) < 2.5 * far
        assert np.isfinite(depth).mean() > 0.5


def test_views_lie_at_all_angles_and_robots_in_both_halls():
    rng = np.random.default_rng(0)
    for name in ("halls", "halls_apart"):
        plan = plan_named(name, 0)
        places = np.array([T[:2, 3] for T in stations(plan, 30, rng)])
        inside = [[room.holds(place) for place in places] for room in plan.rooms]
        assert min(sum(one) for one in inside) >= 5
    headings = np.degrees(
        [np.arctan2(T[1, 0], T[0, 0]) for T in stations(plan_named("facade", 0), 30, rng)]
    )
    angles = np.abs(headings[:, None] - headings[None])
    assert np.histogram(angles, (0, 20, 40, 60, 100))[0].min() >= 20


def test_a_seed_is_one_world_and_another_seed_another():
    a, b = (PlanWorld("facade", 3, 2, seed) for seed in (0, 1))
    again = PlanWorld("facade", 3, 2, 0)
    assert np.array_equal(a.shoot(0).left, again.shoot(0).left)
    assert not np.allclose(a.T_world_robot(0), b.T_world_robot(0))
    assert not np.array_equal(a.plan.quads[0].texture, b.plan.quads[0].texture)


def test_every_plan_is_an_option_and_only_those():
    assert set(get_args(PlanName)) == set(PLANS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("plan") / "facade"
    run(SynthOptions(robots=4, seed=2, workers=1, plan="facade", unique=2), out)
    return out


def test_a_plans_folder_is_a_recording_of_every_kind_of_cloud(folder):
    for kind in CLOUD_KINDS:
        views = open_recording(folder, kind).usable
        assert len(views) == 4
        assert all(view.ring_angle_deg is None and view.partner is None for view in views)
        assert min(len(points_of(view)[0]) for view in views) > 100
    assert "--world facade --unique 2 --robots 4 --seed 2" in " ".join(
        (folder / "SOURCE.txt").read_text().split()
    )


def test_a_track_is_one_point_of_the_world_and_alike_windows_are_several(folder):
    recording = open_recording(folder, "sparse")
    views = recording.usable
    places = {}
    for view in views:
        ids, _ = recording.tracks(view)
        points = transform(view.T_world_camera, points_of(view)[1])
        for track, place in zip(ids, points, strict=True):
            assert np.allclose(places.setdefault(track, place), place, atol=2e-4)
    assert max(shared_tracks(recording, a, b) for a in views for b in views if a is not b) > 100
    period = plan_named("facade", 2).symmetries[3][0, 3]
    everywhere = np.array(list(places.values()))
    gaps, _ = KDTree(everywhere).query(everywhere + np.array((period, 0, 0)))
    assert (gaps < 0.02).sum() > 10


def test_images_of_the_folder_are_the_worlds_own(folder):
    world = PlanWorld("facade", 4, 2, seed=2)
    for k, view in enumerate(open_recording(folder, "sparse").usable):
        image = cv2.imread(str(view.image))
        assert np.abs(image.astype(int) - world.shoot(k).left).mean() < 1
        assert np.allclose(view.T_world_camera, world.T_world_robot(k) @ mount())


def test_what_cannot_be_is_said(tmp_path):
    for options, words in (
        (SynthOptions(robots=6), "8 to 72"),
        (SynthOptions(robots=8, unique=3), "--world"),
        (SynthOptions(robots=8, plan="labyrinth"), "facade"),
    ):
        with pytest.raises(FleetPoseError, match=words):
            run(options, tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_a_plan_is_served_live_with_its_own_rig_and_its_truth(tmp_path):
    options = WorldOptions(robots=3, seed=2, plan="corridor", unique=4)
    world = world_of(options)
    write_truth(world, tmp_path / "truth")
    truth = WorldTruth(tmp_path / "truth", {"a": "r1", "b": "r3"})
    assert np.allclose(truth._content()["T_world_robots"]["r3"], world.T_world_robot("r3"))
    server = WorldServer(("127.0.0.1", 0), world, None)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    try:
        camera = open_camera(f"127.0.0.1:{server.server_address[1]}/r3", "once")
        frame = next(camera.frames())
        camera.close()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
    baseline_m = frame.model.noise.focal_baseline_px_m / frame.model.K[0, 0]
    assert baseline_m == pytest.approx(world.plan.baseline_m)
    seen = world.scene.image(
        world.T_world_robot("r3") @ mount(), world.rig.K_left, (WIDTH, HEIGHT), samples=2
    )
    assert np.corrcoef(frame.image.ravel()[::50], seen.ravel()[::50])[0, 1] > 0.98


def test_a_fleet_in_a_plan_starts_a_world_of_that_plan(tmp_path):
    options = FleetOptions(robots=3, seconds=30.0, world="facade", unique=7, seed=5)
    world = " ".join(plan_fleet(options, tmp_path).world)
    assert "--plan facade --unique 7" in world
    assert "--seed 5" in world
    for wrong in (
        FleetOptions(robots=3, seconds=30.0, world="facade", moving=True),
        FleetOptions(robots=3, seconds=30.0, unique=7),
        FleetOptions(robots=3, seconds=30.0, world="facade", data=(tmp_path,)),
    ):
        with pytest.raises(FleetPoseError, match="--world"):
            plan_fleet(wrong, tmp_path)
    with pytest.raises(FleetPoseError, match="stand still"):
        world_of(WorldOptions(robots=3, plan="facade", turning=("r2",)))


def test_questions_are_answered_on_anything_with_contrast_and_wrongly_if_asked_to(folder, tmp_path):
    recording = open_recording(folder, "stereo_dense")
    wires = {}
    for view in recording.usable:
        robot = f"r{view.index}"
        stripped = strip(recording, [view], tmp_path / robot, random.Random(0))
        wires[view.index] = tmp_path / f"{robot}.msgpack"
        encode(robot, stripped.camera, stripped.path, wires[view.index])
    i, j = max(
        combinations(recording.usable, 2), key=lambda pair: len(true_pixels(recording, *pair)[0])
    )

    def errors_px(mistakes: float, visit: int) -> np.ndarray:
        task = Task(recording, wires, 0, Limits.of(6.0, rgbd=False), mistakes)
        clicks = clicks_in(task, (i.index, j.index), visit)
        depth = true_depth(recording, i)
        points = np.array([lifted_at(i, depth, uv) for uv, _ in clicks])
        there = transform(inverse(j.T_world_camera) @ i.T_world_camera, points)
        return np.linalg.norm(
            (there @ j.K.T)[:, :2] / there[:, 2:] - [uv for _, uv in clicks], axis=1
        )

    right = np.concatenate([errors_px(0.0, visit) for visit in range(4)])
    wrong = np.concatenate([errors_px(1.0, visit) for visit in range(4)])
    assert np.median(right) < 5.0
    assert np.median(wrong) > 15.0


def lifted_at(view, depth, uv) -> np.ndarray:
    column, row = np.rint(uv).astype(int)
    return np.linalg.inv(view.K) @ (*uv, 1.0) * depth[row, column]
