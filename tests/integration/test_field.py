"""A whole fleet of real processes from its bundles: mutual TLS, and rules that deny by default."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.system.fleet import FleetPlan, plan_world
from fleetpose.evaluation.system.observer import Observer
from fleetpose.protocol.codec import encoding_of, unpack
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import Alignment, OperatorUpdate, PairCorrespondences
from fleetpose.protocol.slots import Sample
from fleetpose.protocol.transport import Link, SessionSettings, open_session, wait_until
from tests.deploy.field_makers import Field
from tests.integration.test_fleet_of_processes import CLICKS, FIRST_POSE_S, true_clicks

ROBOTS = ("r1", "r2", "r3")
LATE_S = 60.0
REPLAYED = 20


@pytest.fixture
def field(tmp_path):
    return Field(tmp_path)


@contextmanager
def running(field: Field) -> Iterator[LocalFleet]:
    """Router, world, server and robots, each with what its bundle gives it."""
    plan = plan_world(ROBOTS, field.folder, moving=False, seed=0)
    with LocalFleet(field.folder / "logs") as fleet:
        fleet.endpoint = f"tcp/127.0.0.1:{field.router().port}"
        router = field.configuration("router/a")
        fleet.start("router", "fleetpose.pose_server", "router", "--config", str(router))
        fleet.wait_accepting()
        fleet.start("world", "fleetpose.evaluation", *plan.world)
        state = ("--workers", "2", "--state-dir", str(field.folder / "state"))
        config = ("--config", str(field.configuration("server")))
        fleet.start("server", "fleetpose.pose_server", "run", *config, *state)
        assert wait_until(plan.truth.is_there, FIRST_POSE_S), fleet.tail("world")
        start_robots(field, fleet, plan)
        yield fleet


def start_robots(field: Field, fleet: LocalFleet, plan: FleetPlan) -> None:
    for robot in plan.robots:
        folder = field.install(f"robot/{robot.name}")
        settings = folder / "robot.toml"
        camera = f'name = "{robot.name}"\ncamera = "{robot.camera}"\ndata = "{robot.data}"\n'
        settings.write_text(camera)
        config = ("--config", str(folder / "zenoh.json5"), "--settings", str(settings))
        fleet.start(robot.name, "fleetpose.robot_agent", "run", *config)


@contextmanager
def link_of(field: Field, who: str) -> Iterator[Link]:
    link = Link(open_session(SessionSettings(config_file=field.configuration(who))))
    try:
        yield link
    finally:
        link.close()


def hmi(field: Field, who: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    config = ("--config", str(field.configuration(who)), "--operator", who.partition("/")[2])
    command = [sys.executable, "-P", "-m", "fleetpose.hmi_client", *arguments, *config]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.timeout(240)
def test_a_fleet_from_bundles_is_located_clicks_are_receipted_and_who_comes_late_has_all(field):
    with (
        running(field) as fleet,
        link_of(field, "observer/wall") as link,
        link_of(field, "server") as of_server,
    ):
        observer = Observer(link, Keys("demo"))
        views = Observer(of_server, Keys("demo"))  # nobody else may hear the robots' clouds
        knowing = SimpleNamespace(poses=observer.poses, view=views.view)

        def located() -> bool:
            fleet.check()
            seen = observer.poses()
            return all(name in seen and seen[name].pose.located for name in ROBOTS)

        assert wait_until(located, FIRST_POSE_S), fleet.tail("server")
        said: list[Sample] = []
        of_server.on_latched(Keys("demo").updates("anna"), said.append)
        clicks = true_clicks(knowing, field.folder, fleet)
        click(field, *clicks)
        assert_late_client_has_everything(field, CLICKS)
        replay(field, [sample.payload for sample in said])
        click(field, moved(clicks[0]))
        assert_late_client_has_everything(field, CLICKS + 1)
        status = hmi(field, "observer/wall", "status")
        assert "3 of 3 robots located" in status.stdout, status.stdout + status.stderr
        assert hmi(field, "observer/wall", "why", "r2").returncode == 0
        assert not views.poses(), "the server hears no poses: it says them"
        observer.close()
        views.close()
    assert fleet.leftover_processes() == 0


def moved(click: str) -> str:
    """Another point: within a pixel of one that is there it would be refused."""
    return ",".join(f"{float(value) + 3.0:.1f}" for value in click.split(","))


def click(field: Field, *clicks: str) -> None:
    """Anna adds points; the command ends with 0 once they are receipted."""
    add = ("correspondences", "add", "r1", "r2", *clicks, "--timeout", "20")
    done = hmi(field, "operator/anna", *add)
    assert done.returncode == 0, done.stdout + done.stderr


def replay(field: Field, updates: list[bytes]) -> None:
    """Anna's true bytes again and again, by herself and by another operator."""
    assert len(updates) >= CLICKS
    keys, encoding = Keys("demo"), encoding_of(OperatorUpdate)
    with link_of(field, "operator/anna") as anna, link_of(field, "operator/ben") as ben:
        for link, key in ((anna, "anna"), (ben, "ben"), (ben, "anna")):
            for payload in updates * REPLAYED:
                link.session.put(keys.updates(key), payload, encoding=encoding)


def assert_late_client_has_everything(field: Field, clicks: int) -> None:
    """The set and the alignments were said before it came: caches answer it."""
    sets: dict[str, int] = {}
    aligned: set[tuple[str, str]] = set()
    keys = Keys("demo")

    def note_set(sample: Sample) -> None:
        told = unpack(PairCorrespondences, sample.payload, sample.encoding)
        sets[f"{told.i}-{told.j}"] = len(told.items)

    def note_alignment(sample: Sample) -> None:
        told = unpack(Alignment, sample.payload, sample.encoding)
        aligned.add((told.view_i.robot, told.view_j.robot))

    with link_of(field, "operator/ben") as late:
        late.on_latched(keys.correspondences("*", "*"), note_set)
        late.on_latched(keys.alignment("*", "*"), note_alignment)
        assert wait_until(lambda: sets.get("r1-r2") == clicks, LATE_S), sets
        assert wait_until(lambda: len(aligned) == 3, LATE_S), aligned
