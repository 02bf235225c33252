"""Mirrored cameras: told by what their descriptors are, named by who contradicts them."""

import dataclasses

import numpy as np

from fleetpose.pose_server.calibration.mirrors import Mirrors
from fleetpose.pose_server.registration.pair import PAIR, Pair
from fleetpose.pose_server.registration.prepared_view import PreparedView, prepare_view
from fleetpose.pose_server.registration.verdict.mirrored import (
    is_mirrored,
    mirrored,
    mirrored_descriptors,
)
from tests.pose_server.scene import pair_of_views, turned


def flipped(view: PreparedView) -> PreparedView:
    """The same view by a camera whose driver flips its images."""
    return dataclasses.replace(
        view,
        observed=mirrored(view.observed),
        descriptors=mirrored_descriptors(view.descriptors),
    )


def like_sift(view: PreparedView) -> PreparedView:
    """The made-up descriptors of the scene, as long as SIFT's."""
    long = np.repeat(view.descriptors, 128 // view.descriptors.shape[1], axis=1)
    long /= np.linalg.norm(long, axis=1, keepdims=True)
    return dataclasses.replace(view, descriptors=long)


def views(seed: int = 4) -> tuple[PreparedView, PreparedView]:
    i, j = pair_of_views(np.random.default_rng(seed), turned(12))
    return like_sift(prepare_view(i)), like_sift(prepare_view(j))


def test_mirroring_twice_is_nothing():
    i, _ = views()
    assert np.array_equal(flipped(flipped(i)).descriptors, i.descriptors)
    assert np.allclose(flipped(flipped(i)).observed.uv, i.observed.uv)


def test_views_that_fit_only_mirrored_are_told_and_others_are_not():
    i, j = views()
    assert is_mirrored(Pair(i, flipped(j), PAIR.ratio), 0)
    assert is_mirrored(Pair(flipped(i), j, PAIR.ratio), 0)
    assert not is_mirrored(Pair(i, j, PAIR.ratio), 0)
    assert not is_mirrored(Pair(flipped(i), flipped(j), PAIR.ratio), 0)


def test_a_view_of_something_else_is_not_mirrored():
    i, _ = views()
    _, other = views(9)
    assert not is_mirrored(Pair(i, flipped(other), PAIR.ratio), 0)


def test_who_contradicts_the_most_is_named():
    said = Mirrors()
    for a, b in (("r1", "r2"), ("r2", "r3"), ("r1", "r3")):
        said.note(a, b, False)
    said.note("r4", "r1", True)
    said.note("r3", "r4", True)
    (found,) = said.flipped()
    assert found.sure and found.robots == {"r4": 2}


def test_two_robots_alone_are_both_under_suspicion():
    said = Mirrors()
    said.note("r1", "r2", True)
    (found,) = said.flipped()
    assert not found.sure and set(found.robots) == {"r1", "r2"}
    said.forget("r2")
    assert said.flipped() == []


def test_robots_that_fit_as_they_are_are_of_one_kind_whatever_a_single_pair_says():
    for odd in (("r1", "r2"), ("r1", "r3"), ("r2", "r3")):
        said = Mirrors()
        for a, b in (("r1", "r2"), ("r2", "r3"), ("r1", "r3")):
            said.note(a, b, (a, b) == odd)
        assert said.flipped() == []


def test_one_pair_that_fits_mirrored_by_chance_accuses_nobody_who_fits_others():
    said = Mirrors()
    for a, b in (("r1", "r2"), ("r2", "r3"), ("r4", "r5"), ("r5", "r6"), ("r6", "r7")):
        said.note(a, b, False)
    said.note("r3", "r4", True)
    assert said.flipped() == []
    for a, b in (("r2", "r4"), ("r2", "r5")):
        said.note(a, b, True)
    (found,) = said.flipped()
    assert found.sure and found.robots == {"r2": 2, "r3": 1}
