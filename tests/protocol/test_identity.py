"""A configuration that says whose it is: names and sites are its, others are refused."""

import json

import pytest

from fleetpose.hmi_client.settings import ClientSettings
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.robot_agent.settings import RobotSettings

CAMERA = {"camera": "rgbd"}


@pytest.fixture
def file_of(tmp_path):
    """Writes configurations: `file_of({"site": ..., "role": ..., "name": ...})`."""

    def write(told):
        file = tmp_path / "zenoh.json5"
        metadata = {} if told is None else {"fleetpose": told}
        file.write_text(json.dumps({"mode": "client", "metadata": metadata}))
        return file

    return write


def told(role, name, site="church"):
    return {"site": site, "role": role, "name": name}


def test_site_and_name_are_the_configurations(file_of):
    robot = RobotSettings.load(None, {**CAMERA, "config": file_of(told("robot", "r7"))})
    assert (robot.site, robot.name) == ("church", "r7")
    server = ServerSettings.load(None, {"config": file_of(told("server", "server"))})
    assert server.site == "church"
    wall = ClientSettings.load(None, {"config": file_of(told("observer", "wall"))})
    assert (wall.site, wall.operator) == ("church", "wall")


def test_the_same_may_be_said_again(file_of, tmp_path):
    settings = tmp_path / "robot.toml"
    settings.write_text('name = "r7"\nsite = "church"\ncamera = "rgbd"\n')
    config = file_of(told("robot", "r7"))
    assert RobotSettings.load(settings, {"config": config}).name == "r7"


def test_who_does_not_say_may_be_anybody(file_of):
    given = {**CAMERA, "config": file_of(None), "name": "r2"}
    assert RobotSettings.load(None, given).site == "demo"


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"name": "r2"}, "--name r2: .* is the configuration of robot 'r7' of site 'church'"),
        ({"name": "r7", "site": "demo"}, "--site demo: .*leave --site out"),
    ],
)
def test_another_name_or_site_is_refused(file_of, given, sentence):
    with pytest.raises(FleetPoseError, match=sentence):
        RobotSettings.load(None, {**CAMERA, **given, "config": file_of(told("robot", "r7"))})


def test_another_name_from_the_environment_is_refused(file_of, monkeypatch):
    monkeypatch.setenv("FLEETPOSE_ROBOT_NAME", "r2")
    with pytest.raises(FleetPoseError, match="--name r2"):
        RobotSettings.load(None, {**CAMERA, "config": file_of(told("robot", "r7"))})


def test_another_roles_configuration_is_refused(file_of):
    with pytest.raises(FleetPoseError, match=r"of operator 'anna' .* take that of a robot"):
        RobotSettings.load(None, {**CAMERA, "config": file_of(told("operator", "anna"))})
    with pytest.raises(FleetPoseError, match="take that of an operator or an observer"):
        ClientSettings.load(None, {"config": file_of(told("robot", "r7"))})


@pytest.mark.parametrize(
    "bad", [{"site": "church"}, told("robot", "R 7"), told("king", "r7"), "r7", [1], 3]
)
def test_what_is_no_identity_is_refused_in_a_sentence(file_of, bad):
    with pytest.raises(FleetPoseError, match=r"zenoh.json5"):
        RobotSettings.load(None, {**CAMERA, "config": file_of(bad)})
