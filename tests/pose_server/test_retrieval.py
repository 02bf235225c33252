"""The index of keyframes: what it finds, what it forgets, and that it counts as it says."""

import numpy as np
import pytest

from fleetpose.pose_server.retrieval.hamming_index import INDEX, NOBODY, HammingIndex
from fleetpose.pose_server.retrieval.kernels import count_votes
from fleetpose.pose_server.retrieval.view_index import ViewIndex
from fleetpose.pose_server.tuned import replace_in_use
from fleetpose.protocol.messages import ViewName

rng = np.random.default_rng(11)


def descriptors(count: int, length: int = 128) -> np.ndarray:
    """Bytes as of RootSIFT: none negative, of one norm."""
    drawn = np.abs(rng.normal(size=(count, length))) ** 2
    return (512 * drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).clip(0, 255).astype("u1")


def seen_again(some: np.ndarray) -> np.ndarray:
    return (some.astype(float) + rng.normal(scale=5.0, size=some.shape)).clip(0, 255).astype("u1")


def unit(some: np.ndarray) -> np.ndarray:
    return (some / np.linalg.norm(some, axis=1, keepdims=True)).astype(np.float32)


def name(n: int) -> ViewName:
    return ViewName(robot=f"r{n}", epoch="0123456789ab", seq=0)


@pytest.fixture
def small_cells():
    before = INDEX.room
    replace_in_use("index.room", 4)
    yield
    replace_in_use("index.room", before)


def test_the_kernel_counts_as_its_words_say():
    signatures = rng.integers(0, 2**64, (3, 5), np.uint64)
    owners = rng.integers(NOBODY, 4, (3, 5)).astype(np.int32)
    added = np.array([9, 5, 2])
    cells, asked = rng.integers(0, 3, 40), rng.integers(0, 2**64, 40, np.uint64)
    expected = np.zeros(4)
    for cell, word in zip(cells, asked, strict=True):
        here = slice(0, min(added[cell], 5))
        differ = np.bitwise_count(signatures[cell, here] ^ word).astype(int)
        near = (differ <= 30) & (owners[cell, here] >= 0)
        weights = (31.0 - differ[near]) ** 2 / np.sqrt(max(near.sum(), 1))
        np.add.at(expected, owners[cell, here][near], weights)
    votes = count_votes(signatures, owners, added, cells, asked, 4, 30)
    assert expected.any() and votes == pytest.approx(expected)


@pytest.mark.parametrize("length", [33, 128])
def test_views_that_share_a_quarter_of_their_points_are_found_among_many(length):
    index, views = ViewIndex(), [descriptors(200, length) for _ in range(100)]
    for n, one in enumerate(views):
        index.add(name(n), one)
    for n in (0, 3, 50, 99):
        part = np.concatenate((seen_again(views[n][:50]), descriptors(150, length)))
        assert index.most_alike(part)[0] == name(n)


def test_while_there_are_few_all_may_be_alike():
    index = ViewIndex()
    for n in range(3):
        index.add(name(n), descriptors(20))
    assert index.most_alike(descriptors(20)) == [name(n) for n in range(3)]


def test_descriptors_of_another_length_are_of_another_kind():
    index = ViewIndex()
    index.add(name(1), descriptors(20, 128))
    index.add(name(2), descriptors(20, 33))
    assert index.most_alike(descriptors(20, 33)) == [name(2)]


def test_a_full_cell_forgets_its_oldest_and_grows_no_more(small_cells):
    index, first = HammingIndex(unit(descriptors(2000))), descriptors(40)
    index.add(unit(first), 0)
    assert index.votes(unit(first), 1)[0] > 0
    for owner in range(1, 400):
        index.add(unit(descriptors(300)), owner)
    assert index._signatures.shape == (INDEX.cells, 4)
    votes = index.votes(unit(first), 400)
    assert votes[0] == 0 and votes.any()


def test_what_is_no_keyframe_any_more_is_forgotten_once_that_is_worth_it():
    index, views = ViewIndex(), [descriptors(20) for _ in range(1300)]
    for n, one in enumerate(views):
        index.add(name(n), one)
    stay = {name(n) for n in range(0, 1300, 13)}
    index.forget_others(stay, 1000)
    assert index.most_alike(seen_again(views[1]))[0] == name(1)
    index.forget_others(stay, len(stay))
    found = index.most_alike(seen_again(views[13]))
    assert found[0] == name(13) and set(found) <= stay
    index.add(name(5000), views[1])
    assert index.most_alike(views[1])[0] == name(5000)
