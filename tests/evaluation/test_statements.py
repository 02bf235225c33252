"""What rings say of the paper's three statements: by hand-made tables of errors and times."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.evaluation.bench.ring.statements import left, moved, statements

SEPARATIONS_DEG = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0)
errors = st.floats(1e-4, 1e4)


def rings(*by_clicks, icp_ms=(9.0, 8.0, 7.0, 5.0, 4.0, 3.0), clicks=tuple(range(6))):
    """The rings of several separations, of each the errors by number of clicks."""
    return [
        {
            "separation_deg": separation_deg,
            "clicks": n,
            "position_error_m": error_m,
            "position_error_median_m": error_m,
            "icp_ms": icp_ms[n],
        }
        for separation_deg, errors_m in zip(SEPARATIONS_DEG, by_clicks, strict=False)
        for n, error_m in zip(clicks, errors_m, strict=True)
    ]


def answers(table):
    return [statement.holds for statement in statements(table)]


AS_IN_THE_PAPER = (10.0, 9.0, 8.0, 1.0, 0.9, 0.8)
WITHOUT_GAIN = (1.0,) * 6


@given(st.lists(errors, min_size=6, max_size=6))
def test_errors_as_in_the_papers_figure_are_yes_at_any_scale(scales):
    table = rings(*(np.multiply(scale, AS_IN_THE_PAPER) for scale in scales))
    assert answers(table) == [True] * 5
    assert all(one.met == one.separations == 6 for one in statements(table))


def test_clicks_that_change_nothing_are_no():
    assert answers(rings(WITHOUT_GAIN, WITHOUT_GAIN, icp_ms=(5.0,) * 6)) == [False] * 5


def test_clicks_that_do_harm_are_no():
    worse = AS_IN_THE_PAPER[::-1]
    assert answers(rings(worse, worse, icp_ms=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))) == [False] * 5


@pytest.mark.parametrize(
    ("errors_m", "slight"),
    [
        ((10.0, 9.0, 8.0, 1.0, 1.0, 1.0), True),  # nothing more to gain
        ((10.0, 9.0, 8.0, 2.0, 1.0, 0.5), True),  # 1.5 of 8
        ((10.0, 9.0, 8.0, 4.0, 4.0, 2.0), False),  # 2 of 6
        ((10.0, 9.0, 8.0, 1.0, 1.0, 4.0), False),  # worse again
    ],
)
def test_more_clicks_are_slight_by_what_three_took_away(errors_m, slight):
    assert answers(rings(errors_m))[2:4] == [slight] * 2


def test_the_median_over_separations_decides_and_the_others_are_counted():
    mostly = statements(rings(AS_IN_THE_PAPER, AS_IN_THE_PAPER, WITHOUT_GAIN))[0]
    assert mostly.holds and (mostly.met, mostly.separations) == (2, 3)
    half = statements(rings(AS_IN_THE_PAPER, WITHOUT_GAIN))[0]
    assert not half.holds and (half.met, half.separations) == (1, 2)


def test_an_error_without_bound_is_gained_if_three_clicks_end_it_and_else_is_not():
    ended = [None, None, None, 1.0, 1.0, 1.0]
    assert answers(rings(ended))[:4] == [True] * 4
    for lost in ([None] * 6, [1.0, 1.0, 1.0, None, None, None]):
        assert answers(rings(lost))[:4] == [False] * 4
    assert answers(rings([None, None, None, 1.0, None, 1.0]))[2:4] == [False] * 2


@given(st.tuples(*[st.one_of(st.just(0.0), st.just(np.inf), errors)] * 6))
def test_every_share_is_a_number_from_zero_up(values):
    by_clicks = dict(enumerate(values))
    for share in (left(by_clicks), moved(by_clicks)):
        assert share is not None and share >= 0.0


def test_what_was_not_measured_is_not_answered():
    without_more = statements(rings((10.0, 1.0), clicks=(0, 3)))
    assert [one.holds for one in without_more] == [True, True, None, None, True]
    assert "not asked" in without_more[2].line
    assert answers(rings((1.0,), clicks=(0,))) == [None] * 5
    assert answers([]) == [None] * 5


def test_an_answer_says_what_counts_and_its_figure():
    line = statements(rings(AS_IN_THE_PAPER))[0].line
    assert "drastically: yes" in line and "0.10" in line and "below 0.5 at 1 of 1" in line
