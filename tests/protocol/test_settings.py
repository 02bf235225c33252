"""Settings of every process: each from the place that goes first, and none wrong in silence."""

import os
import subprocess
import sys
import tomllib

import pytest
from typer.testing import CliRunner

from fleetpose.hmi_client.cli.commands import app as client
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.settings import SettingsRefusedError


def test_a_dumped_file_gives_the_same_settings_again(tmp_path):
    file = tmp_path / "settings.toml"
    settings = ServerSettings.load(None, {"workers": 3, "connect": ["tcp/10.0.0.1:7447"]})
    file.write_text(settings.as_toml())
    assert ServerSettings.load(file, {}) == settings
    assert tomllib.loads(file.read_text())["connect"] == ["tcp/10.0.0.1:7447"]


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"workers": 0}, "'workers' of the command line"),
        ({"connect": ["10.0.0.1:7447"]}, "write PROTOCOL/ADDRESS:PORT"),
        ({"connect": ["10.0.0.1"]}, "e.g. tcp/10.0.0.1:7447"),
        ({"connect": ["tcp/10.0.0.1"]}, "it needs a port .* e.g. tcp/10.0.0.1:7447"),
        ({"connect": ["tcp/10.0.0.1:74470"]}, "it needs a port from 1 to 65535"),
        ({"connect": ["tpc/10.0.0.1:7447"]}, "'tpc' is no protocol"),
        ({"anchor": "R1"}, "'R1' is no name"),
        ({"icp": "magic"}, "'icp'"),
    ],
)
def test_a_wrong_value_is_named_with_its_place(given, says):
    with pytest.raises(SettingsRefusedError, match=says):
        ServerSettings.load(None, given)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("workerz = 2", "no setting 'workerz'; is 'workers' meant"),
        ("workers = 'two'", "'workers' of"),
        ("workers = ", "cannot be read"),
        ("\0", "cannot be read"),
    ],
)
def test_a_wrong_file_is_named_with_what_is_wrong(tmp_path, text, says):
    file = tmp_path / "settings.toml"
    file.write_text(text)
    with pytest.raises(SettingsRefusedError, match=says):
        ServerSettings.load(file, {})


def test_variables_are_read_and_those_that_mean_nothing_are_named(monkeypatch):
    monkeypatch.setenv("FLEETPOSE_SERVER_WORKERS", "5")
    monkeypatch.setenv("FLEETPOSE_HMI_SITE", "of another process")
    assert ServerSettings.load(None, {}).workers == 5
    for written in ("tcp/a:1,tcp/b:2", '["tcp/a:1", "tcp/b:2"]'):
        monkeypatch.setenv("FLEETPOSE_SERVER_LISTEN", written)
        assert ServerSettings.load(None, {}).listen == ("tcp/a:1", "tcp/b:2")
    monkeypatch.setenv("FLEETPOSE_SERVER_LISTEN", "0.0.0.0:7447")
    with pytest.raises(SettingsRefusedError, match=r"\(FLEETPOSE_SERVER_LISTEN\): .*tcp/0"):
        ServerSettings.load(None, {})
    monkeypatch.delenv("FLEETPOSE_SERVER_LISTEN")
    monkeypatch.setenv("FLEETPOSE_SERVER_STATEDIR", "/data")
    with pytest.raises(SettingsRefusedError, match="is 'FLEETPOSE_SERVER_STATE_DIR' meant"):
        ServerSettings.load(None, {})


@pytest.mark.parametrize(
    ("program", "arguments", "says"),
    [
        ("pose_server", ("run", "--workers", "0"), "'workers'"),
        ("pose_server", ("run", "--connect", "127.0.0.1:7447"), "write PROTOCOL/ADDRESS:PORT"),
        ("pose_server", ("run", "--config", "nowhere.json5"), "nowhere.json5"),
        ("robot_agent", ("run", "--name", "R 1", "--camera", "rgbd"), "'name'"),
        ("hmi_client", ("status", "--connect", "127.0.0.1:7447"), "write PROTOCOL/ADDRESS:PORT"),
        ("hmi_client", ("status", "--config", "nowhere.json5"), "nowhere.json5"),
    ],
)
def test_every_process_says_it_in_one_sentence(tmp_path, program, arguments, says):
    done = subprocess.run(
        [sys.executable, "-P", "-m", f"fleetpose.{program}", *arguments],
        capture_output=True, text=True, timeout=150, check=False, cwd=tmp_path,
        env={**os.environ, "COLUMNS": "200"},
    )  # fmt: skip
    assert done.returncode != 0 and says in done.stderr
    assert "Traceback" not in done.stderr and done.stderr.count("\n") == 1


def test_the_client_takes_a_setting_from_the_command_line_before_environment_and_file(tmp_path):
    file = tmp_path / "client.toml"
    file.write_text('site = "file"\ntheme = "light"\noperator = "anna"\n')
    ask = ["--settings", str(file), "--theme", "mono", "--dump-settings"]
    done = CliRunner().invoke(client, ask, env={"FLEETPOSE_HMI_SITE": "environment"})
    told = tomllib.loads(done.output)
    assert (told["theme"], told["site"], told["operator"]) == ("mono", "environment", "anna")
    wrong = CliRunner().invoke(client, ["status"], env={"FLEETPOSE_HMI_SIGHT": "x"})
    assert "is 'FLEETPOSE_HMI_SITE' meant" in str(wrong.exception)
