"""The fleet's frame is level where robots know up: turned once, about its origin, and kept."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.consistency.levelling import RELEVEL_RAD, level, robust_mean
from fleetpose.pose_server.correspondences.journal import Journal
from fleetpose.pose_server.frontend.frames import body_pose, upright
from fleetpose.pose_server.geometry.se3 import exp_so3, inverse, make_pose
from fleetpose.pose_server.persistence.graph_writer import graph_of
from fleetpose.pose_server.persistence.placed import placed_views
from fleetpose.pose_server.persistence.restore import note_frame, restored_site
from fleetpose.pose_server.pose_graph.types import FleetSolution, NodePose
from fleetpose.pose_server.state.site import Site
from fleetpose.protocol.messages import ViewName
from tests.pose_server.point_makers import random_pose, seeds
from tests.pose_server.scene import EPOCH, view
from tests.pose_server.test_doubts import PLACES, fleet, receive, seen, state_of
from tests.pose_server.test_flows import kept, site_of

SEEN = kept(
    view(
        np.random.default_rng(0),
        "r0",
        np.random.default_rng(0).uniform((-3, -3, 9), (3, 3, 11), (50, 3)),
        np.zeros((50, 64), np.uint8),
        np.eye(4),
    )
)
ROBOTS, KEYFRAMES = 4, 3


def unit(vector):
    return vector / np.linalg.norm(vector)


def solved(rng, knowing=(), noise_rad=0.005) -> tuple[Site, np.ndarray]:
    """A solved fleet and T_root_world: the world's z is up, and some robots know that."""
    site, T_root_world = site_of(), random_pose(rng)
    names = [ViewName(robot=f"r{k // 3}", epoch=EPOCH, seq=k % 3) for k in range(12)]
    T_root_cameras = [np.eye(4), *(random_pose(rng) for _ in names[1:])]
    for name, T in zip(names, T_root_cameras, strict=True):
        up = T[:3, :3].T @ T_root_world[:3, 2]
        up = exp_so3(rng.normal(0, noise_rad, 3)) @ up if name.robot in knowing else None
        mounted = replace_mount(SEEN.camera, random_pose(rng))
        site.views.keep(replace(SEEN, name=name, camera=mounted, up_camera=up))
    for name in names:
        site.robot(name.robot).track.recall(name)
    poses = {
        name: NodePose(T, names[0], "verified", None)
        for name, T in zip(names, T_root_cameras, strict=True)
    }
    site.solved(FleetSolution(poses, {names[0]: tuple(names)}, {}, {}, (), False))
    site.set_gauge(names[0])
    return site, T_root_world


def replace_mount(camera, T_robot_camera):
    return camera.model_copy(update={"T_robot_camera": T_robot_camera})


def off_level_deg(site: Site, T_root_world) -> float:
    z = (site.fleet_from_root(site.gauge) @ T_root_world)[:3, 2]
    return float(np.degrees(np.arccos(np.clip(z[2], -1, 1))))


def bodies(site: Site):
    T_fleet_root = site.fleet_from_root(site.gauge)
    return {
        name: body_pose(T_fleet_root, node.T_root_camera, site.views[name].camera.T_robot_camera)
        for name, node in site.solution.nodes.items()
    }


@settings(max_examples=40, deadline=None)
@given(seeds, st.sets(st.sampled_from(["r0", "r1", "r2", "r3"]), min_size=1))
def test_a_tilted_fleet_that_knows_up_ends_level_about_its_origin(rng, knowing):
    site, T_root_world = solved(rng, knowing)
    before = bodies(site)
    level(site)
    assert off_level_deg(site, T_root_world) < 1.0
    assert site.gauge_revision <= 1 and site.knows_up(site.gauge)
    assert not level(site), "it is level now"
    after, revision = bodies(site), site.gauge_revision
    first = site.gauge
    assert np.allclose(after[first][:3, 3], 0, atol=1e-9), "the origin stays"
    for name in after:
        kept_relative = inverse(after[first]) @ after[name]
        assert np.allclose(kept_relative, inverse(before[first]) @ before[name], atol=1e-9)
    turn = after[first][:3, :3] @ before[first][:3, :3].T
    assert np.allclose(turn, upright(turn.T[:, 2])[:3, :3], atol=1e-9), "the heading stays"
    assert (revision == 1) == (not np.allclose(turn, np.eye(3)))


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_without_ups_nothing_is_turned(rng):
    site, _ = solved(rng)
    before = bodies(site)
    assert not level(site) and site.gauge_revision == 0 and not site.anchoring.levels
    assert all(np.array_equal(before[name], T) for name, T in bodies(site).items())


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_it_is_turned_again_only_where_it_is_off_by_more_than_is_stated(rng):
    site, T_root_world = solved(rng, ("r1", "r2"), noise_rad=0.0)
    assert level(site) and site.gauge_revision == 1
    for share, turned in ((0.8, False), (1.3, True)):
        lean = make_pose(exp_so3(share * RELEVEL_RAD * np.array([1.0, 0, 0])), np.zeros(3))
        T_fleet_root = site.fleet_from_root(site.gauge)
        T_root_leaning = inverse(T_fleet_root) @ lean @ T_fleet_root @ T_root_world
        for name, node in site.solution.nodes.items():
            up = node.T_root_camera[:3, :3].T @ T_root_leaning[:3, 2]
            if site.views[name].up_camera is not None:
                site.views.keep(replace(site.views[name], up_camera=up))
        assert level(site) == turned
    assert site.gauge_revision == 2


@settings(max_examples=40, deadline=None)
@given(seeds, st.floats(0.0, 0.45))
def test_less_than_half_of_the_votes_cannot_pull_up_away(rng, wrong_share):
    up = unit(rng.normal(0, 1, 3))
    ups = np.array([exp_so3(rng.normal(0, 0.004, 3)) @ up for _ in range(40)])
    wrong = int(40 * wrong_share)
    ups[:wrong] = unit(rng.normal(0, 1, 3))
    found = robust_mean(ups, np.ones(40))
    assert np.degrees(np.arccos(np.clip(found @ up, -1, 1))) < 1.0


@pytest.mark.parametrize("against", [np.array([1.0, 0, 0]), np.array([-1.0, 0, 0])])
def test_ups_that_cancel_still_give_a_direction(against):
    ups = np.array([[1.0, 0, 0], against])
    assert np.linalg.norm(robust_mean(ups, np.ones(2))) == pytest.approx(1.0)


def test_a_fleet_that_learns_up_is_levelled_once_and_for_its_next_life(tmp_path):
    site = fleet()
    state_of(site, "r2", 0.0)
    revision = site.gauge_revision
    up_scene = unit(np.array([0.3, -1.0, 0.2]))
    for seq in range(1, 4):
        for robot in ("r2", "r3"):
            T_camera_scene = PLACES[robot]
            told = {"up_camera": T_camera_scene[:3, :3] @ up_scene, "up_sigma_rad": 0.01}
            receive(site, seen(robot, seq).model_copy(update=told))
    assert site.gauge_revision == revision + 1
    T_r2 = state_of(site, "r2", 3.0).pose.T_fleet_robot
    up_robot = site.views[site.gauge].camera.T_robot_camera[:3, :3] @ PLACES["r2"][:3, :3]
    assert (T_r2[:3, :3] @ up_robot @ up_scene)[2] > np.cos(np.radians(1.0))
    with Journal(tmp_path / "journal.sqlite3") as journal:
        note_frame(journal, site)
        again = restored_site(journal, graph_of(site))
        assert again.gauge_revision == revision + 1 and again.knows_up(again.gauge)
        T = again.fleet_from_root(site.gauge)
        assert np.allclose(T, site.fleet_from_root(site.gauge), atol=1e-12)
    T = site.fleet_from_root(site.gauge) @ site.solution.nodes[site.gauge].T_root_camera
    assert np.allclose(placed_views(site)[site.gauge].T_fleet_camera, T), "exports too"
