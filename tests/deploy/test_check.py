"""`pose-deploy check` names what is wrong with a machine's link in one sentence, and says what to
do.
"""

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.machine.check import SOON_DAYS, State, Step, check
from fleetpose.deploy.machine.install import plan_rules
from fleetpose.deploy.machine.installed import folders_below, tls_files
from fleetpose.deploy.manifest import CA, CERTIFICATE, CONFIGURATION, KEY, MANIFEST
from fleetpose.protocol.session.probe import why_refused
from fleetpose.protocol.transport import SessionSettings, free_port, open_session
from tests.deploy.field_makers import Field

NAMES = ["files", "clock", "certificate", "name", "version", "router a", "session a", "server"]


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return Field(tmp_path_factory.mktemp("field"))


@pytest.fixture(scope="module")
def router(field):
    session = field.start_router()
    with field.open("server") as server:
        token = server.liveliness().declare_token(field.keys.server_alive("a" * 12))
        yield session
        token.undeclare()
    session.close()


@pytest.fixture
def machine(field, tmp_path):
    """Robot r1's machine, newly installed."""
    field.folder, before = tmp_path, field.folder
    yield field.install("robot/r1")
    field.folder = before


def steps(folder: Path, **options) -> dict[str, Step]:
    found = list(check(folder, **options))
    assert all("\n" not in step.text for step in found)
    return {step.name: step for step in found}


def broken(folder: Path, step: str, said: str, state: State = State.BROKEN, **options) -> None:
    """One step is not in order, and no other."""
    found = steps(folder, **options)
    assert said in found[step].text, found
    assert {name: one.state for name, one in found.items() if one.state} == {step: state}


def test_where_all_is_well_every_step_says_so(router, machine):
    found = steps(machine)
    assert list(found) == NAMES
    assert {step.state for step in found.values()} == {State.OK}, found


def test_quick_opens_no_session(router, machine):
    assert list(steps(machine, quick=True)) == NAMES[:-2]


@pytest.mark.parametrize("who", ["server", "operator/anna", "observer/wall", "health/desk"])
def test_every_role_hears_its_own_echo(router, field, who):
    assert steps(field.install(who))["session a"].state is State.OK


def test_a_router_is_told_whether_it_runs_what_is_installed(router, field, tmp_path):
    folder = field.install("router/a")
    assert steps(folder)["rules"].state is State.OK
    newer = field.keeper.folder.rules("a").read_text().replace('"freq": 60.0', '"freq": 61.0')
    told = json.loads(newer)
    told["metadata"]["fleetpose"]["rules"] = "0" * 12
    plan_rules(json.dumps(told).encode(), tmp_path / "router-a.json5", folder.parent).write()
    broken(folder, "rules", "restart it", State.SOON)
    field.install("router/a")


def test_a_site_without_a_server_is_told(field, machine, tmp_path):
    other = Field(tmp_path / "other")
    with other.start_router():
        folder = other.install("robot/r1")
        broken(folder, "server", "has no pose server now", State.SOON)


def test_files_that_are_missing_damaged_or_readable_are_named(field, machine):
    (machine / KEY).chmod(0o644)
    broken(machine, "files", f"chmod 600 {machine / KEY}", quick=True)
    (machine / KEY).chmod(0o600)
    machine.chmod(0o755)
    broken(machine, "files", f"chmod 700 {machine}", quick=True)
    machine.chmod(0o700)
    certificate = (machine / CERTIFICATE).read_bytes()
    (machine / CERTIFICATE).write_bytes(certificate[:200])
    broken(machine, "files", f"{CERTIFICATE} is damaged")
    other = field.keeper.folder.authority().issue(Identity("robot", "r1"), days=9)
    (machine / CERTIFICATE).write_bytes(other.pem)
    broken(machine, "files", f"{CERTIFICATE} is damaged, or not of this bundle")
    (machine / CERTIFICATE).write_bytes(certificate)
    (machine / KEY).write_bytes(other.key_pem or b"")
    broken(machine, "files", f"{KEY} is damaged, or not the certificate's")
    (machine / KEY).unlink()
    broken(machine, "files", f"{machine / KEY} is missing")


@pytest.mark.parametrize("name", [MANIFEST, CONFIGURATION])
@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"\xff\xfe"])
def test_a_damaged_manifest_or_configuration_is_named(machine, name, content):
    (machine / name).write_bytes(content)
    [step] = check(machine)
    assert step.state is State.BROKEN and name in step.text and "\n" not in step.text


def test_another_machines_name_and_another_site_are_named(router, machine):
    settings = machine / "robot.toml"
    before = settings.read_text()
    settings.write_text(before.replace('"r1"', '"r7"'))
    broken(machine, "name", "robot.toml is for 'r7', the certificate for 'r1'")
    settings.write_text(before.replace('"demo"', '"hall"'))
    broken(machine, "name", "is for site 'hall', the certificate for 'demo'")
    settings.write_text(before)
    configuration = machine / CONFIGURATION
    told = json.loads(configuration.read_text())
    told["metadata"]["fleetpose"]["name"] = "r2"
    configuration.write_text(json.dumps(told))
    broken(machine, "name", "zenoh.json5 is for 'r2', the certificate for 'r1'")


def test_a_certificate_is_told_in_time_and_when_it_is_over(machine):
    now = datetime.now(UTC)

    def of_certificate(days: float) -> Step:
        options = {"clock": lambda: now + timedelta(days=days), "quick": True}
        return steps(machine, **options)["certificate"]

    assert of_certificate(90 - SOON_DAYS - 1).state is State.OK
    assert "expires in 10 days" in of_certificate(80).text
    assert of_certificate(80).state is State.SOON
    over = of_certificate(91)
    assert over.state is State.BROKEN
    assert "expired on" in over.text and "pose-deploy renew SITE robot/r1" in over.text


def test_a_clock_a_day_behind_is_named_without_a_network(machine):
    behind = steps(machine, quick=True, clock=lambda: datetime.now(UTC) - timedelta(days=1))
    assert behind["clock"].state is State.BROKEN and "set the clock" in behind["clock"].text


def test_a_clock_a_day_ahead_is_named_by_the_routers(router, machine):
    ahead = datetime.now(UTC) + timedelta(days=1)
    broken(machine, "session a", "1.0 days ahead of the router's", clock=lambda: ahead)


def test_another_version_is_told(router, machine):
    told = json.loads((machine / MANIFEST).read_text())
    (machine / MANIFEST).write_text(json.dumps(told | {"fleetpose": "9.1.0"}))
    broken(machine, "version", "the site's keeper has 9.1.0", State.SOON)


def test_a_certificate_without_rules_is_named(router, field, machine):
    """TLS is in order, and the router lets nothing through."""
    who = Identity("robot", "r1", 2)
    issued = field.keeper.folder.authority().issue(who, days=90)
    (machine / CERTIFICATE).write_bytes(issued.pem)
    (machine / KEY).write_bytes(issued.key_pem or b"")
    told = json.loads((machine / MANIFEST).read_text())
    told |= {"generation": 2, "certificate_sha256": issued.der_sha256}
    (machine / MANIFEST).write_text(json.dumps(told))
    broken(machine, "session a", "rules do not know robot/r1#2")


def to(machine: Path, host: str, port: int) -> None:
    """Another router's address in a machine's manifest."""
    told = json.loads((machine / MANIFEST).read_text())
    told["routers"] = [{"name": "a", "host": host, "port": port}]
    (machine / MANIFEST).write_text(json.dumps(told))


def test_a_router_of_another_site_is_named(machine, tmp_path):
    for site in ("other", "demo"):  # demo: an older site of the same name
        other = Field(tmp_path / site, site=site)
        with other.start_router():
            to(machine, "127.0.0.1", other.router().port)
            broken(machine, "router a", "it is a router of another site")


@pytest.mark.parametrize(
    ("site", "said"), [("other", "is of another site"), ("demo", "is of an older site of the same")]
)
def test_a_certificate_of_another_site_is_named_by_the_router(router, field, tmp_path, site, said):
    """This machine trusts the router, but the router does not know who signed for the machine."""
    folder = Field(tmp_path / site, site=site).install("robot/r1")
    (folder / CA).write_bytes(field.keeper.folder.authority().pem)
    assert said in why_refused(field.router().endpoint, tls_files(folder))


def test_an_expired_certificate_is_named_by_the_router_too(router, field, machine):
    issued = field.keeper.folder.authority().issue(Identity("robot", "r1"), days=-0.01)
    (machine / CERTIFICATE).write_bytes(issued.pem)
    (machine / KEY).write_bytes(issued.key_pem or b"")
    told = json.loads((machine / MANIFEST).read_text())
    told["certificate_sha256"] = issued.der_sha256
    (machine / MANIFEST).write_text(json.dumps(told))
    broken(machine, "router a", "this machine's certificate has expired")


def test_a_router_under_another_name_is_named(router, field, machine):
    to(machine, "localhost", field.router().port)
    broken(machine, "router a", "its certificate is not for 'localhost'")


def test_no_host_no_port_and_no_route_are_told_apart(field, machine, monkeypatch):
    to(machine, "router.invalid", 7447)
    broken(machine, "router a", "there is no host 'router.invalid'")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        to(machine, "127.0.0.1", taken.getsockname()[1])
        broken(machine, "router a", "is the router running?")
    monkeypatch.setattr("fleetpose.protocol.session.probe.CONNECT_S", 0.2)
    with full_backlog() as port:
        to(machine, "127.0.0.1", port)
        broken(machine, "router a", "no route, or a firewall")


@contextmanager
def full_backlog() -> Iterator[int]:
    """A port whose connections are neither accepted nor refused, as behind a firewall."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(0)
        waiting = []
        for _ in range(4):
            one = socket.socket()
            one.setblocking(False)
            one.connect_ex(server.getsockname())
            waiting.append(one)
        yield server.getsockname()[1]
        for one in waiting:
            one.close()


@contextmanager
def listening(answer: bytes | None) -> Iterator[int]:
    """Something that is no router: it answers so, or never."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            link, _ = server.accept()
            with link, suppress(ConnectionResetError):
                link.recv(1000)
                if answer is not None:
                    link.sendall(answer)
                link.recv(1000)

        threading.Thread(target=serve, daemon=True).start()
        yield server.getsockname()[1]


def test_what_speaks_no_tls_is_named(machine, monkeypatch):
    with listening(b"HTTP/1.1 400 Bad Request\r\n\r\n") as port:
        to(machine, "127.0.0.1", port)
        broken(machine, "router a", "speaks no TLS")
    monkeypatch.setattr("fleetpose.protocol.session.probe.HANDSHAKE_S", 0.3)
    with listening(None) as port:
        to(machine, "127.0.0.1", port)
        broken(machine, "router a", "accepts a connection but says nothing")
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_session(SessionSettings(listen=(endpoint,))):
        to(machine, "127.0.0.1", int(endpoint.rpartition(":")[2]))
        broken(machine, "router a", "a zenoh router that speaks no TLS")


def deploy(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "fleetpose.deploy", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_the_command_ends_with_0_1_or_2_as_the_worst_step_went(router, field, machine, tmp_path):
    well = deploy("check", machine.parent)
    assert well.returncode == 0 and well.stdout.count("  ok ") == len(NAMES), well.stdout
    told = json.loads((machine / MANIFEST).read_text())
    soon = (datetime.now(UTC) + timedelta(days=3)).isoformat()
    (machine / MANIFEST).write_text(json.dumps(told | {"not_after": soon}))
    report = deploy("check", machine, "--json")
    assert report.returncode == 1
    [folder] = json.loads(report.stdout)["folders"]
    states = {step["step"]: step["state"] for step in folder["steps"]}
    assert states == dict.fromkeys(NAMES, "ok") | {"certificate": "soon"}
    (machine / KEY).chmod(0o640)
    assert deploy("check", machine).returncode == 2
    nothing = deploy("check", tmp_path / "nothing")
    assert nothing.returncode == 2 and "holds no bundle" in nothing.stderr


def test_a_folder_that_is_closed_to_this_user_is_named(machine, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: Path(path) != machine)
    for folder in (machine, machine.parent):
        with pytest.raises(BundleError, match=f"{machine} is closed to you"):
            folders_below(folder)


def test_the_keeper_compares_a_routers_rules_with_the_folders(router, field):
    site = field.keeper.folder.path
    same = deploy("rules", site, "--check", "a")
    assert same.returncode == 0 and "runs the rules of this folder" in same.stdout, same.stderr
    field.keeper.add("robot", ["r4"])
    other = deploy("rules", site, "--check", "a")
    assert other.returncode == 1 and "runs other rules" in other.stdout
