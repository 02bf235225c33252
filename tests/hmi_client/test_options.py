"""Options of `hmi-client`: before a command, behind it, or with none, as documents write them."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from fleetpose.hmi_client.cli import commands
from fleetpose.hmi_client.cli import connection as c
from fleetpose.hmi_client.errors import OperatorError
from fleetpose.hmi_client.tui import run as run_module
from fleetpose.protocol.errors import EndpointError, NameRefusedError

DESK = "tcp/10.0.0.1:7447"


@pytest.fixture
def asked(monkeypatch):
    """Runs `hmi-client` on a terminal without a screen or network: `asked("why", "r7")` returns
    where it would have connected, and the screen's options if it would have shown one.
    """
    met = {}

    def screen(sites, fps, threshold, log, theme, keys):
        where, *others = sites
        met.update(
            where=where,
            others=others,
            fps=fps,
            threshold=threshold,
            log=log,
            theme=theme,
            keys=keys,
        )

    def server(where, patient=False):
        met["where"] = where
        raise c.NoServerError("none here")

    class Terminal:
        def isatty(self):
            return True

    monkeypatch.setattr(run_module, "run_screen", screen)
    monkeypatch.setattr(c.Connection, "client_of_server", server)
    monkeypatch.setattr(commands, "sys", type("", (), {"stdin": Terminal(), "stdout": Terminal()}))
    for name in ("CONNECT", "SITE", "CONFIG", "OPERATOR", "KEYS", "THEME"):
        monkeypatch.delenv(f"FLEETPOSE_HMI_{name}", raising=False)

    def run(*arguments, env=None):
        met.clear()
        result = CliRunner().invoke(commands.app, arguments, env=env)
        assert met, result.output
        return dict(met)

    return run


def test_the_documents_line_for_the_operators_desk_opens_the_screen(asked):
    assert f"hmi-client --connect {DESK}" in Path("docs/start.md").read_text()
    met = asked("--connect", DESK)
    assert met["where"].connect == (DESK,) and met["fps"] == 10.0


def test_several_sites_are_one_operators_of_one_router(asked, tmp_path):
    met = asked("--connect", DESK, "--site", "hall,yard, hall", "--operator", "anna")
    assert [met["where"].site, *(one.site for one in met["others"])] == ["hall", "yard"]
    assert all((one.connect, one.operator) == ((DESK,), "anna") for one in met["others"])
    with pytest.raises(NameRefusedError):
        c.Connection.each([DESK], "hall,", None, "anna")


def test_a_command_for_one_site_says_so_where_several_are_named():
    with pytest.raises(OperatorError, match="works at one site, name one of them"):
        c.Connection.of([DESK], c.Given("hall,yard"), None, "anna")


def test_a_configuration_for_one_site_serves_no_other_one(tmp_path):
    config = tmp_path / "anna.json5"
    config.write_text(
        '{mode: "client", metadata: {fleetpose: {site: "hall", role: "operator", name: "anna"}}}'
    )
    assert [one.site for one in c.Connection.each([DESK], "demo", config, "")] == ["hall"]
    with pytest.raises(EndpointError, match=r"--site yard: .*operator 'anna' of site 'hall'"):
        c.Connection.each([DESK], c.Given("hall,yard"), config, "")


def test_without_options_it_is_the_screen_of_this_machine(asked):
    met = asked()
    assert met["where"].connect == ("tcp/127.0.0.1:7447",) and met["where"].site == "demo"


@pytest.mark.parametrize(
    "command", [("why", "r7"), ("status",), ("watch",), ("correspondences", "list"), ("screen",)]
)
def test_options_count_before_the_command_as_behind_it(asked, command, tmp_path):
    config = tmp_path / "tls.json5"
    config.write_text("{}")
    options = ("--connect", DESK, "--connect", "tcp/10.0.0.2:7447", "--site", "hall-2")
    options += ("--operator", "anna", "--config", str(config))
    before, behind = asked(*options, *command), asked(*command, *options)
    assert before["where"] == behind["where"]
    where = before["where"]
    assert where.connect == (DESK, "tcp/10.0.0.2:7447") and where.site == "hall-2"
    assert (where.operator, where.config) == ("anna", config)


def test_options_of_the_screen_count_before_it_too(asked):
    met = asked(
        "--fps", "5", "--theme", "light", "--threshold", "0.5", "--keys", "k.toml", "screen"
    )
    assert (met["fps"], met["theme"], met["threshold"]) == (5.0, "light", 0.5)
    assert met["keys"] == Path("k.toml") and asked("--fps", "5")["fps"] == 5.0


def test_what_is_given_behind_the_command_is_nearer(asked):
    met = asked("--site", "hall-1", "--connect", DESK, "why", "r7", "--site", "hall-2")
    assert (met["where"].site, met["where"].connect) == ("hall-2", (DESK,))


def test_what_is_written_counts_more_than_the_environment(asked):
    env = {"FLEETPOSE_HMI_CONNECT": "tcp/10.9.9.9:7447", "FLEETPOSE_HMI_SITE": "attic"}
    where = asked("--connect", DESK, "why", "r7", env=env)["where"]
    assert (where.connect, where.site) == ((DESK,), "attic")
    assert asked(env=env)["where"].connect == ("tcp/10.9.9.9:7447",)


def test_without_a_terminal_it_prints_its_help_and_ends_well():
    result = CliRunner().invoke(commands.app, ["--connect", DESK])
    assert result.exit_code == 0 and "Usage" in result.output
