"""Texts of the error matrix."""

import pytest
from hmi_fakes import fleet
from hypothesis import given
from hypothesis import strategies as st

from fleetpose.hmi_client.model.matrix import (
    BOLD_SHARE,
    HIDDEN,
    QUANTITIES,
    THRESHOLD_SHARE,
    THROUGH,
    UNTRIED,
    default_threshold_m,
    doubt_text,
    is_shown,
    length_text,
    matrix_of,
    percent_text,
    title_of,
)
from fleetpose.hmi_client.model.records import natural
from fleetpose.protocol.messages import PairCell


def matrix(*cells, threshold_m=1.0, count=4):
    return matrix_of(fleet(count, pairs=cells), threshold_m)


def tried(i, j, rmse_m, verdict="verified", **more):
    return PairCell(i=i, j=j, state="tried", verdict=verdict, rmse_m=rmse_m, **more)


def test_a_value_stands_in_both_halves():
    m = matrix(tried("r1", "r2", 0.034))
    assert m.at("r1", "r2") == m.at("r2", "r1")
    assert (m.at("r1", "r2").text, m.unit) == ("3.4", "cm")


def test_errors_of_a_metre_and_more_are_told_in_metres():
    m = matrix(tried("r1", "r2", 1.5), tried("r1", "r3", 0.25), threshold_m=2.0)
    assert (m.at("r1", "r2").text, m.at("r1", "r3").text, m.unit) == ("1.50", "0.25", "m")


def test_above_the_threshold_stands_a_hyphen():
    m = matrix(tried("r1", "r2", 0.3), tried("r1", "r3", 0.2), threshold_m=0.25)
    assert (m.at("r1", "r2").text, m.at("r1", "r3").text) == ("-", "20.0")


@given(st.floats(0.1, 1000.0), st.floats(0.0, 2.0))
def test_the_threshold_follows_the_depth_so_that_no_scene_is_hidden_for_its_size(depth_m, share):
    cell = tried("r1", "r2", share * THRESHOLD_SHARE * depth_m)
    shown = is_shown(cell, default_threshold_m(depth_m))
    assert shown == is_shown(tried("r1", "r2", share), 1.0) or share == pytest.approx(1.0)


def test_a_hidden_error_does_not_change_the_unit():
    assert matrix(tried("r1", "r2", 9.0), tried("r1", "r3", 0.2)).unit == "cm"


def test_rejected_is_a_hyphen_however_small():
    assert matrix(tried("r1", "r2", 0.01, "rejected")).at("r1", "r2").text == "-"


def test_untried_through_others_and_absent_pairs_have_their_signs():
    m = matrix(
        PairCell(i="r1", j="r2", state="untried"), PairCell(i="r1", j="r3", state="through_others")
    )
    assert [m.at("r1", r).text for r in ("r2", "r3", "r4")] == ["·", "~", "·"]


@pytest.mark.parametrize(("shown", "bold"), [(1, 1), (10, 1), (19, 1), (40, 2), (66, 3)])
def test_the_largest_five_per_cent_are_bold_and_at_least_one(shown, bold):
    names = [f"r{k + 1}" for k in range(12)]
    pairs = [tuple(sorted((a, b))) for k, a in enumerate(names) for b in names[k + 1 :]]
    cells = [tried(*pair, 0.01 + 0.001 * k) for k, pair in enumerate(pairs[:shown])]
    m = matrix(*cells, count=12)
    found = [pair for pair in pairs if m.at(*pair).bold]
    assert found == pairs[shown - bold : shown]
    assert bold == max(1, int(BOLD_SHARE * shown))


def test_hidden_errors_are_never_bold():
    m = matrix(tried("r1", "r2", 5.0), tried("r1", "r3", 0.1))
    assert not m.at("r1", "r2").bold and m.at("r1", "r3").bold


def test_clicked_pairs_are_marked_also_when_hidden():
    assert matrix(tried("r1", "r2", 9.0, correspondences=2)).at("r1", "r2").clicked


def test_an_empty_fleet_has_an_empty_matrix():
    assert matrix_of(fleet(0), 1.0).robots == ()


def test_robots_are_sorted_by_number():
    assert sorted(["r10", "r2", "a", "r1"], key=natural) == ["a", "r1", "r2", "r10"]


def test_lengths_carry_their_unit():
    assert [length_text(x) for x in (0.0042, 0.032, 1.5)] == ["4.2 mm", "3.2 cm", "1.50 m"]


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_every_quantity_says_what_the_cell_holds(quantity):
    cell = tried("r1", "r2", 0.05, overlap=0.5, age_s=7.2, regression_error_m2=1.25, p_grave=0.12)
    shown = matrix_of(fleet(4, pairs=(cell,)), 1.0, quantity).at("r1", "r2").text
    words = {"rms": "5.0", "sigma": "2.8", "regression": "1.2", "overlap": "50", "age": "7"}
    words |= {"verdict": "sure", "grave": "12"}
    assert shown == words[quantity] and title_of(quantity, "cm")


def texts_of(cell):
    return [matrix_of(fleet(4, pairs=(cell,)), 1.0, q).at("r1", "r2").text for q in QUANTITIES]


def test_only_errors_hide_behind_the_threshold():
    cell = tried("r1", "r2", 5.0, verdict="plausible", overlap=0.25, p_grave=0.001)
    assert texts_of(cell) == [HIDDEN, "2.8", HIDDEN, "25", "0", "maybe", "0.1"]


def test_a_last_try_that_failed_has_a_hyphen_an_age_and_its_verdict():
    failed = tried("r1", "r2", None, verdict="rejected", age_s=3.0)
    assert texts_of(failed) == [HIDDEN, "2.8", HIDDEN, HIDDEN, "3", "no", HIDDEN]


def test_where_more_than_one_pose_fits_the_verdict_says_how_many():
    cell = tried("r1", "r2", 0.02, verdict="ambiguous", p_grave=0.5, rivals=2)
    assert texts_of(cell)[QUANTITIES.index("verdict")] == "3 fit"


@pytest.mark.parametrize(
    ("known", "words"),
    [
        (("plausible", 0.12, 0), "plausible, 12 % likely to be gravely off"),
        (("ambiguous", 0.4, 2), "ambiguous: 3 poses fit, 40 % likely to be gravely off"),
        (("verified", 0.0004, 0), "verified, <0.1 % likely to be gravely off"),
        (("verified", None, 0), "verified"),
        (("rejected", 0.97, 1), "rejected"),
    ],
)
def test_a_verdict_says_what_speaks_against_it(known, words):
    assert doubt_text(*known) == words


@given(share=st.floats(0.0, 1.0))
def test_no_chance_is_rounded_to_never_or_to_sure(share):
    text = percent_text(share)
    assert (text == "0 %") == (share == 0.0) and (text == "100 %") == (share == 1.0)
    if text[0] not in "<>":
        assert abs(float(text.removesuffix(" %")) - 100 * share) <= 0.5


def test_robots_of_one_component_without_a_cell_are_known_through_others():
    bare = fleet(6).model_copy(update={"pairs": ()})
    matrix = matrix_of(bare, 1.0)
    assert matrix.at("r1", "r4").text == THROUGH and matrix.at("r4", "r2").text == THROUGH
    assert matrix.at("r1", "r5").text == UNTRIED  # r5 stands apart
    assert matrix.at("r1", "r6").text == UNTRIED  # r6 has no pose
