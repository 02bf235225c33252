"""What installing writes: all of it where it belongs, whole, and closed to others."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.machine.bundle import read_bundle
from fleetpose.deploy.machine.install import Plan, described, plan_install, plan_rules
from fleetpose.deploy.machine.system_files import IMAGES, SERVICES, System
from fleetpose.deploy.manifest import CONFIGURATION, KEY
from fleetpose.deploy.sealing import Sealer
from fleetpose.deploy.site.issuing import Keeper
from tests.deploy.field_makers import Field, no_password

ROOT = Path("/etc/fleetpose")
EXPOSURE = 2.0
EVERY_ROLE = ("robot/r1", "server", "router/a", "operator/anna", "observer/wall")
SECRET = {"key.pem", "cert.pem", "ca.pem", "manifest.json", CONFIGURATION}


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return Field(tmp_path_factory.mktemp("field"), routers=("a", "b"))


def planned(field: Field, who: str, image: Path, system: System | None = None) -> Plan:
    return plan_install(read_bundle(field.bundle(who), no_password), ROOT, system, image)


def tree(folder: Path) -> dict[str, int]:
    return {
        str(path.relative_to(folder)): stat.S_IMODE(path.stat().st_mode)
        for path in folder.rglob("*")
        if path.is_file()
    }


def install(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", "fleetpose.deploy", "install", *map(str, arguments)]
    env = {**os.environ, **environment}
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, env=env)


def test_a_dry_run_writes_nothing_and_names_each_file(field, tmp_path):
    options = ("--systemd", "--dry-run", "--image", tmp_path)
    done = install(field.bundle("robot/r1"), *options)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.iterdir()) == []
    plan = planned(field, "robot/r1", tmp_path, System.SYSTEMD)
    assert all(str(file.path) in done.stdout for file in plan.files)
    assert len(plan.commands) == 2 and all(one in done.stdout for one in plan.commands)


def test_a_bundle_under_a_password_is_installed_by_the_command_that_knows_it(tmp_path):
    field = Field(tmp_path)
    keeper = Keeper(field.keeper.folder, Sealer("secret"))
    [bundle] = keeper.renew([field.site.member("robot/r1")]).bundles
    bundle.path.chmod(0o644)
    wrong = install(bundle.path, "--root", tmp_path / "m", FLEETPOSE_BUNDLE_PASSWORD="else")
    assert wrong.returncode == 2 and "password is another one" in wrong.stderr
    assert not (tmp_path / "m").exists()
    right = install(bundle.path, "--root", tmp_path / "m", FLEETPOSE_BUNDLE_PASSWORD="secret")
    assert right.returncode == 0, right.stderr
    assert (tmp_path / "m/robot-r1" / KEY).stat().st_mode & 0o777 == 0o600


def test_where_nothing_can_be_written_it_is_one_sentence(field, tmp_path):
    (tmp_path / "file").touch()
    done = install(field.bundle("server"), "--root", tmp_path / "file/below")
    assert done.returncode == 2 and "run it as root, or give --root" in done.stderr
    assert "Traceback" not in done.stderr
    both = install(field.bundle("server"), "--systemd", "--compose")
    assert both.returncode == 2 and "choose one" in both.stderr


@pytest.mark.parametrize("system", [None, *System])
@pytest.mark.parametrize(
    "who", ["robot/r1", "server", "router/a", "operator/anna", "observer/wall"]
)
def test_all_that_is_planned_is_written_below_the_image_and_closed_to_others(
    field, tmp_path, who, system
):
    plan = planned(field, who, tmp_path, system)
    plan.write()
    written = tree(tmp_path)
    assert set(written) == {str(file.path.relative_to(tmp_path)) for file in plan.files}
    folder = f"etc/fleetpose/{who.replace('/', '-')}"
    assert {name for name, mode in written.items() if mode == 0o600} == {
        f"{folder}/{name}" for name in SECRET
    }
    assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700
    paths = [line.split()[0] for line in described(plan) if line.startswith("  /")]
    assert len(paths) == len(plan.files)


def test_the_configuration_names_the_files_where_they_will_be_found(field, tmp_path):
    planned(field, "router/a", tmp_path).write()
    told = json.loads((tmp_path / "etc/fleetpose/router-a" / CONFIGURATION).read_text())
    tls = told["transport"]["link"]["tls"]
    named = [value for value in tls.values() if isinstance(value, str)]
    assert len(named) == 5
    assert all((tmp_path / name.lstrip("/")).is_file() for name in named)
    elsewhere = plan_install(read_bundle(field.bundle("server"), no_password), tmp_path / "x")
    elsewhere.write()
    text = (tmp_path / "x/server" / CONFIGURATION).read_text()
    assert str(tmp_path / "x/server/key.pem") in text and "/etc/fleetpose" not in text


def test_clients_know_all_routers_and_a_router_those_before_it(field, tmp_path):
    def endpoints(who: str) -> list[str]:
        files = read_bundle(field.bundle(who), no_password).files
        told = json.loads(files[CONFIGURATION])["connect"]["endpoints"]
        return [endpoint.partition("#")[0] for endpoint in told]

    a, b = (field.router(name).endpoint for name in ("a", "b"))
    assert endpoints("robot/r1") == endpoints("operator/anna") == [a, b]
    assert endpoints("router/a") == [] and endpoints("router/b") == [a]


def test_a_robots_settings_that_were_edited_stay(field, tmp_path):
    plan = planned(field, "robot/r1", tmp_path)
    plan.write()
    settings = tmp_path / "etc/fleetpose/robot-r1/robot.toml"
    settings.write_text(settings.read_text() + "rate_hz = 2.0\n")
    again = planned(field, "robot/r1", tmp_path)
    assert any(str(settings) in line and "stays" in line for line in described(again))
    again.write()
    assert "rate_hz = 2.0" in settings.read_text()


def test_a_renewed_bundle_replaces_the_old_one_in_place(field, tmp_path):
    planned(field, "robot/r2", tmp_path).write()
    key = tmp_path / "etc/fleetpose/robot-r2" / KEY
    before = key.read_bytes()
    field.keeper.renew([field.site.member("robot/r2")])
    planned(field, "robot/r2", tmp_path).write()
    assert key.read_bytes() != before and not list(key.parent.glob(".*"))


def test_new_rules_are_installed_at_their_router_and_nowhere_else(field, tmp_path):
    planned(field, "router/a", tmp_path).write()
    field.keeper.add("robot", ["r8"])
    rules = field.keeper.folder.rules("a")
    plan = plan_rules(rules.read_bytes(), rules, ROOT, tmp_path)
    assert plan.commands == ("systemctl restart fleetpose-router-a",)
    plan.write()
    installed = (tmp_path / "etc/fleetpose/router-a" / CONFIGURATION).read_text()
    assert "robot/r8" in installed
    other = field.keeper.folder.rules("b")
    with pytest.raises(BundleError, match="router-b"):
        plan_rules(other.read_bytes(), other, ROOT, tmp_path)


def test_a_bundle_without_a_key_waits_for_the_machines_own(field, tmp_path):
    files = dict(read_bundle(field.bundle("robot/r3"), no_password).files)
    key = files.pop(KEY)
    bundle = type(read_bundle(field.bundle("robot/r3"), no_password))(
        read_bundle(field.bundle("robot/r3"), no_password).manifest, files
    )
    with pytest.raises(BundleError, match=r"put it at .*key\.pem first"):
        plan_install(bundle, ROOT, image=tmp_path)
    place = tmp_path / "etc/fleetpose/robot-r3" / KEY
    place.parent.mkdir(parents=True)
    place.write_bytes(key)
    plan_install(bundle, ROOT, image=tmp_path).write()
    assert place.read_bytes() == key


def units(field: Field, image: Path) -> list[Path]:
    for who in ("robot/r1", "server", "router/a"):
        planned(field, who, image, System.SYSTEMD).write()
    return sorted((image / "etc/systemd/system").iterdir())


def analyze(*arguments: object) -> subprocess.CompletedProcess[str]:
    program = shutil.which("systemd-analyze")
    if program is None:
        pytest.skip("no systemd-analyze here")
    command = [program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_systemd_finds_nothing_wrong_with_the_units(field, tmp_path):
    made = units(field, tmp_path)
    assert len(made) == 9
    done = analyze("verify", "--man=no", *made)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@pytest.mark.parametrize("who", ["robot-r1", "server", "router-a", "check-server"])
def test_units_expose_little(field, tmp_path, who):
    units(field, tmp_path)
    unit = f"fleetpose-{who}.service"
    done = analyze("security", "--offline=yes", f"--root={tmp_path}", unit)
    found = re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)
    assert found is not None, done.stdout + done.stderr
    assert float(found[1]) <= EXPOSURE


def test_units_are_ready_only_when_the_process_says_so_and_watched(field, tmp_path):
    for who in ("robot/r1", "server", "router/a"):
        planned(field, who, tmp_path, System.SYSTEMD).write()
        text = (
            tmp_path / f"etc/systemd/system/fleetpose-{who.replace('/', '-')}.service"
        ).read_text()
        lines = text.splitlines()
        assert {"Type=notify", "WatchdogSec=30", "Restart=always"} <= set(lines)
        assert "$" not in text


@pytest.mark.parametrize(
    ("python", "hidden"),
    [("/opt/fleetpose/bin/python", "yes"), ("/home/ann/venv/bin/python", "read-only")],
)
def test_units_find_their_programs_wherever_they_are(field, tmp_path, monkeypatch, python, hidden):
    monkeypatch.setattr(sys, "executable", python)
    for who in ("robot/r1", "server", "router/a"):
        planned(field, who, tmp_path, System.SYSTEMD).write()
    for unit in (tmp_path / "etc/systemd/system").glob("*.service"):
        text = unit.read_text()
        assert f"ExecStart={Path(python).parent}/" in text
        assert f"ProtectHome={hidden}" in text.splitlines()


def test_tcp_of_robots_and_routers_takes_loss_for_loss(field, tmp_path):
    planned(field, "robot/r1", tmp_path, System.SYSTEMD).write()
    text = (tmp_path / "etc/sysctl.d/90-fleetpose.conf").read_text()
    assert "net.ipv4.tcp_congestion_control = bbr" in text.splitlines()
    assert "net.ipv4.tcp_notsent_lowat = 16384" in text.splitlines()


def test_routers_have_a_packet_filter_for_their_own_port(field, tmp_path):
    planned(field, "router/a", tmp_path, System.SYSTEMD).write()
    text = (tmp_path / "etc/fleetpose/router-a/fleetpose.nft").read_text()
    assert set(re.findall(r"tcp dport (\S+)", text)) == {str(field.router("a").port)}
    nft = shutil.which("nft")
    if nft is not None:
        subprocess.run([nft, "--check", "--file", "-"], input=text.encode(), check=True)


@pytest.mark.parametrize("role", SERVICES)
def test_the_compose_file_has_a_hardened_service_for_each_role(field, tmp_path, role):
    who = {"robot": "robot/r1", "server": "server", "router": "router/a"}[role]
    planned(field, who, tmp_path, System.COMPOSE).write()
    folder = tmp_path / "etc/fleetpose" / who.replace("/", "-")
    services = yaml.safe_load((folder / "compose.yaml").read_text())["services"]
    [service] = [one for one in services.values() if role in one["profiles"]]
    assert service["read_only"] and service["cap_drop"] == ["ALL"]
    assert service["image"] == f"fleetpose-{IMAGES[role]}"
    told = dict(line.split("=", 1) for line in (folder / ".env").read_text().splitlines())
    assert told["COMPOSE_PROFILES"] == role
    assert told["FLEETPOSE_FOLDER"] == f"/etc/fleetpose/{who.replace('/', '-')}"
    assert set(re.findall(r"\$\{(\w+)\}", (folder / "compose.yaml").read_text())) <= set(told)


def test_every_image_of_the_compose_file_is_a_target_of_the_dockerfile(field, tmp_path):
    planned(field, "server", tmp_path, System.COMPOSE).write()
    folder = tmp_path / "etc/fleetpose/server"
    targets = set(re.findall(r"^FROM \S+ AS (\w+)$", (folder / "Dockerfile").read_text(), re.M))
    services = yaml.safe_load((folder / "compose.yaml").read_text())["services"]
    images = {one["image"].removeprefix("fleetpose-") for one in services.values()}
    assert images == set(IMAGES.values()) and images <= targets


def test_docker_reads_the_compose_file(field, tmp_path):
    docker = shutil.which("docker")
    if docker is None or subprocess.run([docker, "compose", "version"], check=False).returncode:
        pytest.skip("no docker compose here")
    planned(field, "server", tmp_path, System.COMPOSE).write()
    folder = tmp_path / "etc/fleetpose/server"
    done = subprocess.run(
        [docker, "compose", "--project-directory", str(folder), "config"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert list(yaml.safe_load(done.stdout)["services"]) == ["server"]
