"""Pairs that stay open are tried again with wide sets, and no others."""

import numpy as np
import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.scheduling import affine_retries, pair_queue
from fleetpose.pose_server.state.affine_retries import MOST_SETS
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import Done
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import pack
from tests.pose_server.scene import descriptors, inverse, pair_of_views, turned, view, walls
from tests.pose_server.test_flows import named, site_of, work_off

T_TRUE = turned(15)
BOTH = [named(0, "r1"), named(0, "r2")]


def one_look_each(rng: np.random.Generator):
    """Two views of one place whose salient points do not look alike."""
    points = walls(rng, 800)
    looks = descriptors(rng, 800), descriptors(rng, 800)
    poses = np.eye(4), inverse(T_TRUE)
    return [
        view(rng, robot, points, look, T)
        for robot, look, T in zip(("r1", "r2"), looks, poses, strict=True)
    ]


@pytest.fixture
def site() -> Site:
    return site_of(*one_look_each(np.random.default_rng(1)))


@pytest.fixture
def wide() -> list[bytes]:
    """The same views with points that do look alike."""
    return [pack(v) for v in pair_of_views(np.random.default_rng(2), T_TRUE)]


def test_an_open_pair_is_aligned_once_both_robots_have_answered(site, wide):
    assert work_off(site) == ["pair"]
    assert site.relative(*BOTH) is None
    assert sorted(map(str, affine_retries.wanted(site))) == sorted(map(str, BOTH))
    assert affine_retries.wanted(site) == []  # they are asked already
    affine_retries.receive(site, BOTH[0], wide[0])
    assert work_off(site) == []
    affine_retries.receive(site, BOTH[1], wide[1])
    assert work_off(site) == ["pair"]
    T = site.relative(*BOTH)
    assert T is not None and np.linalg.norm(T[:3, 3] - T_TRUE[:3, 3]) < 0.1
    assert affine_retries.wanted(site) == [] and not site.affine_retries.waiting


def test_a_pair_whose_robot_has_no_wide_set_is_given_up(site, wide):
    work_off(site)
    affine_retries.wanted(site)
    affine_retries.receive(site, BOTH[0], wide[0])
    affine_retries.receive(site, BOTH[1], None)
    assert not site.affine_retries.waiting and work_off(site) == []
    pipeline.take_result(site, Done(job := _again(site), run_job(job)), 1.0)
    assert affine_retries.wanted(site) == []


def _again(site: Site):
    site.pair("r1", "r2").untried[BOTH[0], BOTH[1]] = 1.0
    pair_queue.enqueue(site, ("r1", "r2"), 1.0)
    job = pipeline.next_job(site, 1.0)
    assert job is not None
    return job


def test_what_is_settled_asks_for_nothing():
    site = site_of(*pair_of_views(np.random.default_rng(3), T_TRUE))
    work_off(site)
    assert affine_retries.wanted(site) == [] and site.counts.get("wide_alignments", 0) == 0


def test_views_that_never_align_are_not_tried_for_ever(site, wide):
    for _ in range(6):
        pipeline.take_result(site, Done(job := _again(site), run_job(job)), 1.0)
        site.affine_retries.waiting.clear()
    assert sum(site.affine_retries.tries.values()) <= 3


def test_sets_are_bounded(site, wide):
    for seq in range(MOST_SETS + 10):
        affine_retries.receive(site, named(seq, "r1"), wide[0])
    assert len(site.affine_retries.sets) == MOST_SETS
