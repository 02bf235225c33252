"""What starts the processes of a machine: systemd units, or containers by compose."""

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from importlib.resources import files
from pathlib import Path
from string import Template

from fleetpose.deploy.manifest import CONFIGURATION, Manifest

SERVICES = ("robot", "server", "router")
"""Roles that run without anybody at a screen."""
IMAGES = {**{role: role for role in SERVICES}, "operator": "hmi", "observer": "hmi"}
"""The image of each role that can run in a container."""
CONTAINER_USER = 7447
"""Of the images: the number to whom the keys must belong."""


class System(StrEnum):
    """What starts the processes."""

    SYSTEMD = "systemd"
    COMPOSE = "compose"


@dataclass(frozen=True)
class SystemFile:
    """A file that everybody may read, at its place on the machine."""

    path: Path
    content: bytes
    keep: bool = False


def system_files(
    manifest: Manifest, folder: Path, system: System | None
) -> tuple[list[SystemFile], tuple[str, ...]]:
    """The files beside the bundle's, and the commands that start what they describe.

    Args:
        manifest: whose bundle it is.
        folder: where it is installed.
        system: what starts the processes; None starts nothing.
    """
    role = manifest.role
    settings = [_robot_settings(manifest, folder)] if role == "robot" else []
    if system is System.SYSTEMD and role in SERVICES:
        more, commands = _systemd(manifest, folder)
    elif system is System.COMPOSE and role in IMAGES:
        more, commands = _compose(manifest, folder)
    else:
        more, commands = [], (_by_hand(manifest, folder),)
    return [*settings, *more], commands


def _systemd(manifest: Manifest, folder: Path) -> tuple[list[SystemFile], tuple[str, ...]]:
    who, bin_folder = manifest.identity, Path(sys.executable).parent
    unit = f"fleetpose-{who.folder}.service"
    values = {"bin": bin_folder, "folder": folder, "site": manifest.site, "name": who.name}
    values |= {"unit": who.folder, "who": who.who, "home": _protect_home(bin_folder)}
    found = [
        SystemFile(Path("/etc/systemd/system") / unit, _filled(f"{who.role}.service", values)),
        *(
            SystemFile(
                Path("/etc/systemd/system") / f"fleetpose-check-{who.folder}.{kind}",
                _filled(f"check.{kind}", values),
            )
            for kind in ("service", "timer")
        ),
        SystemFile(Path("/etc/sysusers.d/fleetpose.conf"), _read("sysusers.conf")),
        SystemFile(Path("/etc/sysctl.d/90-fleetpose.conf"), _read("sysctl.conf")),
    ]
    if who.role == "router":
        port = next(one.port for one in manifest.routers if one.name == who.name)
        found.append(SystemFile(folder / "fleetpose.nft", _filled("router.nft", {"port": port})))
    return found, (
        "systemd-sysusers && sysctl --system --quiet && systemctl daemon-reload",
        f"systemctl enable --now {unit} fleetpose-check-{who.folder}.timer",
    )


def _protect_home(bin_folder: Path) -> str:
    """Homes are hidden from the services, unless the programs themselves are installed in one."""
    return "read-only" if bin_folder.parts[1:2] in (("home",), ("root",)) else "yes"


def _compose(manifest: Manifest, folder: Path) -> tuple[list[SystemFile], tuple[str, ...]]:
    who = manifest.identity
    variables = {
        "COMPOSE_PROJECT_NAME": f"fleetpose-{who.folder}",
        "COMPOSE_PROFILES": who.role,
        "FLEETPOSE_FOLDER": str(folder),
        "FLEETPOSE_SITE": manifest.site,
        "FLEETPOSE_NAME": who.name,
    }
    environment = "".join(f"{name}={value}\n" for name, value in variables.items())
    found = [
        SystemFile(folder / "compose.yaml", _read("compose.yaml")),
        SystemFile(folder / ".env", environment.encode()),
        SystemFile(folder / "Dockerfile", _read("Dockerfile")),
        SystemFile(Path("/etc/sysctl.d/90-fleetpose.conf"), _read("sysctl.conf")),
    ]
    image = IMAGES[who.role]
    build = f"docker build -f {folder}/Dockerfile --target {image} -t fleetpose-{image} CHECKOUT"
    start = "up -d" if who.role in SERVICES else "run --rm operator"
    return found, (
        f"sysctl --system --quiet && {build}",
        f"docker compose --project-directory {folder} {start}",
    )


def _by_hand(manifest: Manifest, folder: Path) -> str:
    who, config = manifest.identity, folder / CONFIGURATION
    return {
        "robot": f"robot-agent run --config {config} --settings {folder}/robot.toml",
        "server": f"pose-server run --config {config} --site {manifest.site}",
        "router": f"pose-server router --config {config}",
        "health": f"pose-deploy check {folder}",
        "recorder": f"pose-server record --config {config} --out {manifest.site}.mcap",
    }.get(
        who.role,
        f"hmi-client --config {config} --site {manifest.site} --operator {who.name}",
    )


def _robot_settings(manifest: Manifest, folder: Path) -> SystemFile:
    values = {"site": manifest.site, "name": manifest.name}
    return SystemFile(folder / "robot.toml", _filled("robot.toml", values), keep=True)


def _filled(name: str, values: Mapping[str, object]) -> bytes:
    return Template(template(name)).substitute(values).encode()


def _read(name: str) -> bytes:
    return template(name).encode()


def template(name: str) -> str:
    """One of the files that come with the package; `$name` stands for what differs."""
    return (files("fleetpose.deploy") / "files" / name).read_text()
