"""Intervals over views, and what tells whether covariances are right."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fleetpose.evaluation.metrics.intervals import share_over_views
from fleetpose.evaluation.metrics.scoring import trimmed_nees_per_dof

PAIRS = list(itertools.combinations(range(12), 2))


def width(found):
    return found.high - found.low


@settings(max_examples=30)
@given(st.lists(st.booleans(), min_size=len(PAIRS), max_size=len(PAIRS)))
def test_the_interval_holds_the_share(flags):
    found = share_over_views(PAIRS, flags)
    assert 0 <= found.low <= found.share <= found.high <= 1
    assert found.share == pytest.approx(np.mean(flags))


def test_pairs_repeated_do_not_tighten_the_interval():
    flags = [(i + j) % 3 > 0 for i, j in PAIRS]
    assert width(share_over_views(PAIRS * 10, flags * 10)) == pytest.approx(
        width(share_over_views(PAIRS, flags))
    )


def test_views_that_fail_as_a_whole_widen_the_interval():
    together = [0 in pair or 1 in pair for pair in PAIRS]
    alone = np.random.default_rng(0).permutation(together)
    assert width(share_over_views(PAIRS, together)) > 1.3 * width(share_over_views(PAIRS, alone))


def test_more_views_tighten_the_interval():
    def of(views):
        pairs = list(itertools.combinations(range(views), 2))
        flags = np.random.default_rng(1).random(len(pairs)) < 0.7
        return width(share_over_views(pairs, flags))

    assert of(40) < 0.5 * of(8)


def test_no_pair_has_no_share_and_one_pair_has_no_width():
    assert share_over_views([], []).share is None
    only = share_over_views([(3, 7)], [True])
    assert (only.share, only.low, only.high, only.pairs) == (1.0, 1.0, 1.0, 1)


def test_right_covariances_have_a_trimmed_nees_of_one_per_degree_of_freedom():
    rng = np.random.default_rng(2)
    values = rng.chisquare(6, 20_000)
    assert trimmed_nees_per_dof(values) == pytest.approx(1.0, abs=0.02)
    assert trimmed_nees_per_dof(4 * values) == pytest.approx(4.0, abs=0.08)
    values[:900] = 1e9  # below a twentieth
    assert trimmed_nees_per_dof(values) < 1.2
    assert trimmed_nees_per_dof([]) is None
