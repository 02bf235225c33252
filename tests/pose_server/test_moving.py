"""Points that move against a robot's own views are masked, and what stands still is not."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.pose_server.calibration.monitor import note_motion
from fleetpose.pose_server.correspondences.store import CorrespondenceStore
from fleetpose.pose_server.frontend.localization import followed, newest_arrived
from fleetpose.pose_server.frontend.moving_points import MOST_MASKED, moving_masks, without_moving
from fleetpose.pose_server.geometry.features.motion import Mask, moves_together
from fleetpose.pose_server.geometry.se3 import inverse
from fleetpose.pose_server.registration.align import align_pair
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import prepare_view
from fleetpose.pose_server.registration.verdict.evaluate import PairResult
from fleetpose.pose_server.state.site import Site
from fleetpose.pose_server.workers.jobs import Done, PairJob, TrackJob
from fleetpose.pose_server.workers.run import run_job
from fleetpose.protocol.codec import pack
from fleetpose.protocol.messages import View
from tests.pose_server.scene import descriptors, turned, view, walls
from tests.pose_server.test_flows import Forgetful, kept

COUNT = 900


def views_of_one_robot(rng, moves_m: float, share: float = 0.1) -> tuple[View, View, np.ndarray]:
    """Two views of a robot that walks, and which scene points moved meanwhile: a block of them."""
    points, looks = walls(rng, COUNT), descriptors(rng, COUNT)
    by_distance = np.argsort(np.linalg.norm(points[:, :2] - (1.0, 0.5), axis=1))
    block = np.zeros(COUNT, bool)
    block[by_distance[: int(share * COUNT)]] = True
    later = points + moves_m * block[:, None] * np.array([0.8, 0.1, 0.3])
    step = turned(3.0)
    first = view(rng, "r1", points, looks, np.eye(4), seq=0)
    return first, view(rng, "r1", later, looks, inverse(step), seq=1), points[block]


def shares_masked(message: View, mask: Mask | None, moved: np.ndarray) -> tuple[float, float]:
    """Of the first view's moved points and of the others, the share that is masked."""
    observed = prepare_view(message).observed
    if mask is None:
        return 0.0, 0.0
    seen, _ = observed.project(moved)
    near = np.linalg.norm(observed.uv[:, None] - seen, axis=2).min(axis=1) < 3.0
    hit = mask.hits(observed.uv)
    return float(hit[near].mean()), float(hit[~near].mean())


@pytest.mark.parametrize("seed", range(5))
def test_a_block_that_moves_is_masked_and_the_rest_is_not(seed):
    first, second, moved = views_of_one_robot(np.random.default_rng(seed), 0.6)
    result = align_pair(prepare_view(first), prepare_view(second))
    assert result.verdict == "verified"
    of_block, of_rest = shares_masked(first, result.moving[0], moved)
    assert of_block > 0.8 and of_rest < 0.02  # the rim of the block


def test_nothing_is_masked_where_nothing_moves():
    for seed in range(20):
        first, second, _ = views_of_one_robot(np.random.default_rng(seed), 0.0)
        assert align_pair(prepare_view(first), prepare_view(second)).moving == (None, None)


def test_without_a_sure_alignment_there_is_no_mask():
    first, second, _ = views_of_one_robot(np.random.default_rng(1), 0.6)
    pair = Pair(prepare_view(first), prepare_view(second), PAIR.ratio)
    sure = align_pair(pair.i, pair.j)
    assert moving_masks(pair, sure)[0] is not None
    assert moving_masks(pair, replace(sure, verdict="ambiguous")) == (None, None)
    assert moving_masks(pair, PairResult(None, None, "rejected", ())) == (None, None)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 0.4))
def test_wrong_matches_that_point_anywhere_are_no_motion(seed, share):
    rng = np.random.default_rng(seed)
    uv = rng.uniform(0, 640, (400, 2))
    off = rng.random(400) < share
    shift = np.where(off[:, None], rng.uniform(-300, 300, (400, 2)), rng.normal(0, 0.5, (400, 2)))
    assert moves_together(uv, shift, off).mean() <= 0.005
    assert not moves_together(uv[:5], shift[:5], np.ones(5, bool)).any()


def test_a_mask_takes_salient_points_and_the_sampled_surface_but_never_most_of_a_view():
    first, second, _ = views_of_one_robot(np.random.default_rng(2), 0.6)
    prepared = prepare_view(first)
    mask = align_pair(prepared, prepare_view(second)).moving[0]
    assert mask is not None
    less = without_moving(prepared, mask)
    gone = mask.hits(prepared.observed.uv)
    assert len(less.observed.uv) == len(less.descriptors) == (~gone).sum() < len(gone)
    assert len(less.surface.sample) < len(prepared.surface.sample)
    assert not mask.hits(less.observed.uv).any()
    everything = Mask(prepared.observed.uv, np.array([[-1e3, -1e3]]), 50.0)
    assert everything.hits(prepared.observed.uv).mean() > MOST_MASKED
    assert without_moving(prepared, everything) is prepared
    assert without_moving(prepared, None) is prepared


def test_the_server_keeps_a_mask_as_long_as_its_view_and_workers_get_it():
    first, second, _ = views_of_one_robot(np.random.default_rng(3), 0.6)
    site = Site(CorrespondenceStore(Forgetful()))
    robot = site.robot("r1")
    for message in (first, second):
        site.views.keep(kept(message))
        newest_arrived(site, robot, site.views[message.name])
    assert site.encoded(first.name).mask is None
    job = TrackJob(site.views[first.name].encoded, site.views[second.name].encoded)
    followed(site, Done(job, run_job(job)))
    encoded = site.encoded(first.name)
    assert encoded.mask is not None and encoded.payload == pack(first)
    both = run_job(PairJob(encoded, site.encoded(second.name)))
    assert both.verdict == "verified"
    robot.track.forget({first.name, second.name})
    assert not robot.track.masks


def test_motion_is_told_once_a_second_view_sees_it_and_not_again_while_it_goes_on():
    site = Site(CorrespondenceStore(Forgetful()))
    site.robot("r1")
    messages = views_of_one_robot(np.random.default_rng(3), 0.6)[:2]
    mask = Mask(np.ones((20, 2)), np.zeros((20, 2)), 5.0)
    told = []
    for at_s in (0.0, 100.0, 101.0, 102.0, 110.0, 300.0):
        view = replace(kept(messages[0]), received_s=at_s)
        site.views.keep(view)
        note_motion(site, view.name, mask)
        told.append(sum("something moves in r1's view" in event for event in site.events))
    assert told == [0, 0, 1, 1, 1, 1]
