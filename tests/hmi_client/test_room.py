"""Whatever the size and the theme: nothing fails, and what is written can be read."""

import re

import pytest
from hmi_fakes import fleet
from hypothesis import given, settings
from hypothesis import strategies as st
from screen_makers import press, screen, selected, text

from fleetpose.hmi_client.cli.reports import table
from fleetpose.hmi_client.desk.advice import Action, Step
from fleetpose.hmi_client.desk.colours import ROLES, WRITTEN, contrast
from fleetpose.hmi_client.desk.words import plain, shortened
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.tui.panels.status_panel import do_lines, fitting

SIZES = st.tuples(st.integers(1, 130), st.integers(1, 45))


@settings(max_examples=3, deadline=None)
@given(st.lists(SIZES, min_size=4, max_size=6), st.sampled_from("mo?g"))
async def test_no_size_is_too_small(sizes, key):
    session = OperatorSession("anna", clock=lambda: 0.0)
    session.on_fleet(fleet(6))
    async with screen(session, (100, 30)) as (app, pilot):
        await selected(session, pilot)
        await press(pilot, key, "space")
        for columns, rows in (*sizes, (1, 1), (2, 1), (1, 9)):
            await pilot.resize_terminal(columns, rows)
            app.tick()
            app.view.repaint()
        await press(pilot, "c")


@pytest.mark.parametrize("theme", ROLES)
def test_what_is_written_can_be_read(theme):
    roles = ROLES[theme]
    bad = {pair: c for pair in WRITTEN if (c := contrast(*(roles[role] for role in pair))) < 4.5}
    assert not bad


def test_contrast_is_that_of_wcag():
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("columns", [40, 80, 100, 160])
async def test_help_and_the_way_out_come_first_and_no_key_is_cut(session, columns):
    async with screen(session, (columns, 24)) as (app, pilot):
        await selected(session, pilot)
        await press(pilot)
        line = text(app.keys)
        assert line.startswith(" ? Help  q Quit ") and "…" not in line
        assert len(app.keys._ends) >= 4
        await pilot.click(app.keys, offset=(line.index("Help"), 0))
        await pilot.pause()
        assert app.screen is not app.screen_stack[0]


@pytest.mark.parametrize("columns", [80, 119, 120])
async def test_below_120_columns_a_pair_that_is_answered_has_all_of_the_screen(session, columns):
    async with screen(session, (columns, 24)) as (app, pilot):
        await selected(session, pilot)
        alone = columns < 120
        assert app.map.display == (not alone or app.map.size.width > 0) or alone
        assert (app.images[0].size.width >= columns // 2 - 2) == alone
        await press(pilot, "2")
        assert app.focused is app.matrix and app.matrix.size.width > 0
        await press(pilot, "4", "m")
        assert (app.map.size.width > 0) == alone


@pytest.mark.parametrize("columns", [80, 100, 160])
async def test_nothing_that_is_written_is_cut(session, columns):
    async with screen(session, (columns, 24)) as (app, pilot):
        with session._changed:
            session._say("the link of r4 is slow: a view takes long; give it another one")
        await press(pilot, "2")
        assert len(str(app.matrix.border_title)) <= app.matrix.size.width
        origin = re.sub("[\u2800-\u28ff]", "", text(app.map).splitlines()[0]).strip()
        assert origin.endswith(("r1", " up", "camera's"))
        last = text(app.status).splitlines()[-1]
        assert "…" not in last and "the link of r4 is slow" in last


def test_what_is_too_long_ends_with_a_thought_or_a_word():
    told = "the link of r4 is slow: a view takes 2.0 s; give it a better one"
    assert shortened(told, 100) == told
    assert shortened(told, 50) == "the link of r4 is slow: a view takes 2.0 s"
    assert shortened(told, 30) == "the link of r4 is slow"
    assert shortened(told, 12) == "the link …"


def test_a_table_that_is_too_wide_becomes_paragraphs():
    head, rows = ("with", "verdict", "newest"), [("r3", "verified", "172 inliers " * 4)]
    assert table(head, rows, 80).splitlines()[0].startswith("with  verdict")
    lines = table(head, rows, 40).splitlines()
    assert lines[0].startswith("with r3: verdict verified; newest 172")
    assert max(map(len, lines)) <= 40


def test_events_are_told_in_plain_words():
    told = plain("r6 is now in component r3 (was r6-0)")
    assert told == "r6 is now in the group of r3"


def test_a_long_step_takes_two_lines_and_facts_are_not_cut():
    now = Step("ask", "t" * 40, ("f" * 20, "g" * 20), (Action("pick", "picks", "Space"),))
    assert do_lines(now, 60) == ["t" * 40 + "   Space picks"]
    assert do_lines(now, 45) == ["t" * 40, "Space picks"]
    assert fitting(now.facts, 30) == "f" * 20
