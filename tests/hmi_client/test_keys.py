"""Keys that a file changes work, are named as they are, and are refused with a sentence."""

import re

import pytest
from screen_makers import press, screen, selected, text
from typer.testing import CliRunner

from fleetpose.hmi_client.cli.commands import app as commands
from fleetpose.hmi_client.desk.keymap import COMMANDS, KeyMap
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.model.fleet_model import FORGOTTEN_S
from fleetpose.hmi_client.tui.app import FleetApp
from fleetpose.hmi_client.tui.panels.matrix_panel import WATCHED
from fleetpose.protocol.messages import Selection


def keymap(tmp_path, toml: str) -> KeyMap:
    path = tmp_path / "keys.toml"
    path.write_text(toml)
    return KeyMap.read(path)


async def test_changed_keys_work_and_are_named_where_keys_are_named(session, tmp_path):
    changed = keymap(tmp_path, 'next = "f5"\npick = ["j", "enter"]\ncancel = "ctrl+k"\n')
    app = FleetApp({"demo": session}, keymap=changed)
    async with app.run_test(size=(160, 50)) as pilot:
        app.tick()
        assert "f5 go to it" in text(app.status)
        await press(pilot, "n")
        assert session.pair is None
        await press(pilot, "f5")
        assert session.pair == ("r5", "r6")
        await selected(session, pilot)
        await press(pilot, "space")
        assert session.half is None
        await press(pilot, "j")
        assert session.half is not None
        assert "ctrl+k cancel" in text(app.status)
        await press(pilot, "ctrl+k")
        assert session.half is None
        await press(pilot, "question_mark")
        assert re.search(r"f5 +Next", str(app.screen._body.render()))


@pytest.mark.parametrize(
    ("toml", "reason"),
    [
        ('jump = "j"', "no command 'jump'"),
        ("next = 3", 'write "n"'),
        ("next = []", 'write "n"'),
        ('next = "nope"', "'nope' is no key"),
        ('next = "super+n"', "'super+n' is no key"),
        ('next = "p"', "'p' is given to both 'next' and 'previous'"),
        ('undo = "g"', "given to both 'undo' and 'go' (images)"),
        ("next = ", "no valid TOML"),
    ],
)
def test_what_is_no_keymap_is_said(tmp_path, toml, reason):
    with pytest.raises(OperatorError, match=re.escape(reason)):
        keymap(tmp_path, toml)


def test_the_command_prints_a_file_that_is_read_as_it_was_written(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    printed = CliRunner().invoke(commands, ["keys"]).output
    assert all(f"{command.id} = " in printed for command in COMMANDS)
    folder = tmp_path / "fleetpose"
    folder.mkdir()
    (folder / "keys.toml").write_text(printed.replace('next = "n"', 'next = "?"\nhelp = "f1"', 1))
    assert CliRunner().invoke(commands, ["keys"]).exit_code != 0  # help is there twice
    again = printed.replace('next = "n"', 'next = "f5"', 1)
    (folder / "keys.toml").write_text(again)
    assert CliRunner().invoke(commands, ["keys"]).output == again.replace(
        'next = "f5"                           #', 'next = "f5"                          #'
    )


async def test_all_pairs_are_shown_at_once_and_chosen_by_key_and_mouse(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "o", "down", "down")
        assert app.matrix.size.width > 150 and not app.map.display
        assert "r3 - r2: 2.0, verified" in text(app.matrix)
        await press(pilot, "enter")
        assert session.pair == ("r2", "r3") and not app.view.desk.overview and app.map.display
        await press(pilot, "o")
        robot = app.matrix._grid.size // 6
        await pilot.click(app.matrix, offset=(1 + 3 * robot + 2, 2 + 2 * robot // 2 + 1))
        assert session.pair == ("r3", "r4")


async def test_the_map_pans_follows_the_pair_and_comes_back(session):
    async with screen(session) as (app, pilot):
        await press(pilot, "1")
        at_first = text(app.map)
        await press(pilot, "right", "shift+down")
        assert text(app.map) != at_first and app.map._middle[0] > 0 > app.map._middle[1]
        await press(pilot, "0")
        assert text(app.map) == at_first
        session.select("r1", "r4")
        await press(pilot, "w")
        assert "following the pair" in str(app.map.border_title)
        assert app.map._middle == pytest.approx((2.2, 1.3), abs=0.2)
        await press(pilot, "left")
        assert not app.view.desk.following


async def test_another_operator_is_shown_at_the_pair_and_forgotten_after_a_while(session, clock):
    ben = Selection(operator="ben", session="0" * 12, i="r1", j="r2", view_i=None, view_j=None)
    async with screen(session) as (app, pilot):
        session.on_selection(ben)
        await press(pilot)
        assert f"1.0{WATCHED}" in text(app.matrix)
        await selected(session, pilot)
        assert "ben is here too" in text(app.status)
        session.on_selection(ben.model_copy(update={"operator": "anna"}))
        assert "anna" not in text(app.status)
        clock.now += FORGOTTEN_S
        app.matrix.repaint()
        app.tick()
        assert WATCHED not in text(app.matrix) and "ben" not in text(app.status)
