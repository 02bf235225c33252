"""One operator at several sites: one screen, one connection, and every click at its own site."""

import json
import shutil
import subprocess
import sys
from contextlib import asynccontextmanager
from unittest.mock import MagicMock

import pytest
from hmi_fakes import fleet, view, wait_for
from screen_makers import press, selected, text

from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.model.session import OperatorSession
from fleetpose.hmi_client.network.shared import SharedLink
from fleetpose.hmi_client.tui.app import FleetApp
from fleetpose.protocol.transport import Link

HMI = [sys.executable, "-P", "-m", "fleetpose.hmi_client"]


@pytest.fixture
def sites(clock):
    """Sessions at two sites; the second asks nothing."""
    hall, yard = (OperatorSession("anna", clock=clock) for _ in range(2))
    hall.on_fleet(fleet(6))
    yard.on_fleet(fleet(5, questions=()))
    return {"hall": hall, "yard": yard}


@asynccontextmanager
async def screen(sites):
    app = FleetApp(sites)
    async with app.run_test(size=(160, 50)) as pilot:
        app.tick()
        await pilot.pause()
        yield app, pilot


async def test_the_line_of_sites_tells_located_questions_and_lost_servers(sites, clock):
    async with screen(sites) as (app, pilot):
        assert "hall  4/6 located, a question waits" in text(app.sites)
        assert "yard  4/5 located " in text(app.sites)
        clock.now += 4.0
        sites["hall"].on_fleet(fleet(6, n=2))
        app.tick()
        await pilot.pause()
        assert "yard  NO SERVER for 4 s" in text(app.sites)


async def test_keys_go_to_the_site_that_is_shown_at_once(sites):
    hall, yard = sites.values()
    async with screen(sites) as (app, pilot):
        await selected(hall, pilot)
        await pilot.press("space", "b", "n", "space", "u")  # half a pick stays at the hall
        assert hall.half is not None and yard.half is None and yard.pair is None
        await selected(yard, pilot)
        await press(pilot, "space", "right", "space")
        assert [len(one.open_updates()) for one in (hall, yard)] == [0, 1]
        await press(pilot, "b")
        assert app.view.site == "hall" and app.focused is app.images[1]
        await press(pilot, "space")
        assert [len(one.open_updates()) for one in (hall, yard)] == [1, 1]


async def test_undo_takes_back_what_was_done_at_the_site_that_is_shown(sites):
    hall, yard = sites.values()
    hall.add(view("r1"), (1.0, 2.0), view("r2"), (3.0, 4.0))
    async with screen(sites) as (_, pilot):
        await press(pilot, "b", "u", "u")
        assert len(hall.entries(("r1", "r2"))) == 1 and not yard.open_updates()
        await press(pilot, "B", "u")
        assert {entry.status for entry in hall.entries(("r1", "r2"))} <= {"erasing"}


async def test_a_click_on_a_site_shows_it(sites):
    async with screen(sites) as (app, pilot):
        await pilot.click(app.sites, offset=(text(app.sites).index("yard"), 0))
        await pilot.pause()
        assert app.view.site == "yard" and "r5" in text(app.map)
        assert app.focused is app.matrix and app.matrix.session is sites["yard"]


async def test_of_one_site_there_is_no_line_and_no_key(session):
    async with screen({"demo": session}) as (app, pilot):
        await press(pilot, "b")
        assert app.view.site == "demo" and not app.sites.is_attached


def test_clients_of_several_sites_share_one_connection(router, serve):
    servers = {site: serve(site=site, count=3) for site in ("hall", "yard")}
    sites = c.Connection.each([router], ",".join(servers), None, "anna")
    with c.servers(sites, patient=False) as (hall, yard):
        hall.select("r1", "r2")
        wait_for(lambda: servers["hall"].selections and servers["hall"].selections[-1].j == "r2")
        yard.add(view("r1"), (1.0, 2.0), view("r2"), (3.0, 4.0))
        wait_for(lambda: yard.confirmed == 1)
    assert not servers["hall"].updates and len(servers["yard"].updates) >= 1
    assert servers["hall"].selections[-1].i is None  # the last thing a client says is that it left


def test_a_shared_connection_ends_with_its_last_client():
    whole = MagicMock(spec=Link, session=object())
    shared = SharedLink(lambda: whole)
    first, second = shared.open(), shared.open()
    assert first.session is second.session is whole.session
    first.close()
    assert not whole.close.called
    second.close()
    whole.close.assert_called_once()


def hmi(*arguments):
    return subprocess.run([*HMI, *arguments], capture_output=True, text=True, timeout=60)


def test_status_tells_all_sites_that_answer_and_fails_if_one_does_not(router, serve):
    serve(site="hall", count=3)
    told = hmi("status", "--site", "hall,yard", "--connect", router)
    assert told.returncode == 3
    assert "site hall" in told.stdout and "2 of 3 robots located" in told.stdout
    assert "no pose server of site 'yard' answered" in told.stdout


def test_watch_names_the_site_of_each_line(router, serve):
    serve(site="hall", count=3)
    serve(site="yard", count=2)
    sites = ("--site", "hall,yard", "--connect", router, "--seconds", "2")
    told = [json.loads(line) for line in hmi("watch", "--json", *sites).stdout.splitlines()]
    poses = {(one["site"], one["robot"]) for one in told if one["type"] == "pose"}
    assert poses == {("hall", "r1"), ("hall", "r2"), ("yard", "r1")}
    assert "hall: pose  r1" in hmi("watch", *sites).stdout


@pytest.mark.skipif(shutil.which("tmux") is None, reason="no tmux")
def test_clicks_in_a_terminal_arrive_at_the_server_of_the_site_that_is_shown(
    router, serve, tmp_path
):
    servers = {"hall": serve(site="hall"), "yard": serve(site="yard")}
    command = [*HMI, "--site", "hall,yard", "--connect", router, "--operator", "anna"]

    def pick_a_pair(terminal, site):
        terminal.wait_text("best question", 30.0)
        terminal.press("n")
        terminal.wait_text("Pick the same point in r5 and in r6", 30.0)
        terminal.press("Space")
        terminal.wait_text("now pick the same point")
        terminal.press("Space")
        wait_for(lambda: servers[site].updates, 20.0)

    with Terminal(command, 160, 50, {"XDG_STATE_HOME": str(tmp_path)}) as terminal:
        terminal.wait_text("yard  4/6 located, a question waits", 30.0)
        pick_a_pair(terminal, "hall")
        assert not servers["yard"].updates
        terminal.press("b")
        pick_a_pair(terminal, "yard")
        terminal.wait_text("1 point confirmed")
        terminal.press("b", "u")  # takes back the hall's alone
        wait_for(lambda: not servers["hall"].sets[("r5", "r6")].items, 20.0)
        servers["yard"].close()
        terminal.wait_text("yard  NO SERVER for", 20.0)
        terminal.press("q")
    assert [u.action for u in servers["yard"].updates if u.n > 1] == []
    assert len(servers["yard"].sets[("r5", "r6")].items) == 1
