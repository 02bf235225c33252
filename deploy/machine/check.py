"""Is this machine's link to its site in order? One step after the other, each in a sentence; what
is broken ends the steps that need it.
"""

import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import IntEnum
from functools import partial
from pathlib import Path

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.machine.bundle import (
    CLOCKS_DIFFER,
    configuration_of,
    der_sha256,
    key_fits,
    metadata_of,
)
from fleetpose.deploy.machine.installed import Installed, installed_in, tls_files
from fleetpose.deploy.machine.running import running_rules
from fleetpose.deploy.manifest import CA, CERTIFICATE, CONFIGURATION, KEY, RouterAddress
from fleetpose.deploy.private_files import readable_by_others
from fleetpose.protocol.session.echo import Echo, clock_fault, echo, unknown_to_rules
from fleetpose.protocol.session.identity import Identity
from fleetpose.protocol.session.probe import Probed, probe
from fleetpose.protocol.text import release

SOON_DAYS = 14.0
FILES = (CA, CERTIFICATE, KEY, CONFIGURATION)


class State(IntEnum):
    """How a step went; the worst of all is the exit code."""

    OK = 0
    SOON = 1
    BROKEN = 2


@dataclass(frozen=True)
class Step:
    """One line of the report."""

    name: str
    state: State
    text: str

    def __str__(self) -> str:
        sign = {State.OK: "ok", State.SOON: "soon", State.BROKEN: "BROKEN"}[self.state]
        return f"  {sign:7}{self.name:13}{self.text}"


ok = partial(Step, state=State.OK)
soon = partial(Step, state=State.SOON)
broken = partial(Step, state=State.BROKEN)

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """By this machine's clock."""
    return datetime.now(UTC)


def check(folder: Path, quick: bool = False, clock: Clock = utc_now) -> Iterator[Step]:
    """The steps for one folder, as they are done.

    Args:
        folder: where a bundle is installed.
        quick: open no session.
        clock: this machine's.
    """
    try:
        installed = installed_in(folder)
        configuration = configuration_of(_read(folder / CONFIGURATION), str(folder / CONFIGURATION))
    except BundleError as error:
        yield broken("files", text=str(error))
        return
    here = [_files(installed), _clock(installed, clock()), _certificate(installed, clock())]
    here += [_name(installed), _version(installed)]
    yield from here
    if here[0].state is State.BROKEN:
        return
    who = installed.who
    member, echoes = Identity(installed.manifest.site, who.role, who.name), []
    for router in installed.manifest.routers:
        probed = probe(router.endpoint, tls_files(folder), clock().timestamp())
        yield _router(router, probed)
        if not probed.error and not quick:
            echoes.append(echo(configuration, member, [router.endpoint]))
            yield _session(installed, router, echoes[-1], clock())
            if who.role == "router" and who.name == router.name:
                yield _rules(configuration, running_rules(configuration, router))
    if any(one.heard for one in echoes):
        yield _server(any(one.server for one in echoes))


def _files(installed: Installed) -> Step:
    folder = installed.folder
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        return broken("files", text=f"{folder / missing[0]} is missing: install the bundle again")
    for path, mode in ((folder, 700), (folder / KEY, 600)):
        if readable_by_others(path):
            return broken(
                "files",
                text=f"{path} can be read by others: chmod {mode} {path}, and have the "
                "certificate renewed if anybody else uses this machine",
            )
    manifest = installed.manifest
    told = {CERTIFICATE: manifest.certificate_sha256, CA: manifest.ca_sha256}
    for name, digest in told.items():
        if der_sha256((folder / name).read_bytes()) != digest:
            return broken(
                "files",
                text=f"{folder / name} is damaged, or not of this bundle: install it again",
            )
    if not key_fits(folder):
        return broken(
            "files",
            text=f"{folder / KEY} is damaged, or not the certificate's: install the bundle again",
        )
    return ok("files", text=f"{len(FILES)} files, the key is its owner's alone")


def _clock(installed: Installed, now: datetime) -> Step:
    issued = installed.manifest.issued
    if now < issued - CLOCKS_DIFFER:
        return broken(
            "clock",
            text=f"it says {now:%Y-%m-%d %H:%M} UTC, but the bundle was made at "
            f"{issued:%Y-%m-%d %H:%M}: set the clock",
        )
    return ok("clock", text=f"{now:%Y-%m-%d %H:%M} UTC")


def _certificate(installed: Installed, now: datetime) -> Step:
    manifest = installed.manifest
    left, ends = manifest.days_left(now), f"{manifest.not_after:%Y-%m-%d %H:%M} UTC"
    renewal = f"ask the site's keeper for 'pose-deploy renew SITE {installed.who.who}'"
    if left < 0:
        return broken("certificate", text=f"it expired on {ends}: {renewal}")
    if left < SOON_DAYS:
        return soon("certificate", text=f"it expires in {left:.0f} days, on {ends}: {renewal}")
    return ok("certificate", text=f"{installed.who.common_name}, holds {left:.0f} days more")


def _name(installed: Installed) -> Step:
    manifest, folder = installed.manifest, installed.folder
    told = {folder / CONFIGURATION: _configured(folder)}
    if (folder / "robot.toml").exists():
        told[folder / "robot.toml"] = _of_settings(folder / "robot.toml", installed)
    for path, (site, name) in told.items():
        if site != manifest.site:
            return broken(
                "name",
                text=f"{path} is for site '{site}', the certificate for '{manifest.site}': "
                "make them the same",
            )
        if name != manifest.name:
            return broken(
                "name",
                text=f"{path} is for '{name}', the certificate for '{manifest.name}': "
                "make them the same",
            )
    return ok("name", text=f"{installed.who.who} of site {manifest.site}")


def _configured(folder: Path) -> tuple[str, str]:
    path = folder / CONFIGURATION
    try:
        site, _, name = metadata_of(path.read_bytes(), str(path))
    except BundleError:
        return "", ""
    return site, name


def _of_settings(path: Path, installed: Installed) -> tuple[str, str]:
    """Site and name of the agent's settings; what they leave out comes from the configuration."""
    try:
        told = tomllib.loads(path.read_text())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError):
        return "", ""
    manifest = installed.manifest
    return str(told.get("site", manifest.site)), str(told.get("name", manifest.name))


def _version(installed: Installed) -> Step:
    here, made = release(), installed.manifest.fleetpose
    if here.split(".")[:2] != made.split(".")[:2]:
        return soon(
            "version",
            text=f"fleetpose {here} here, the site's keeper has {made}: install the same",
        )
    return ok("version", text=f"fleetpose {here}")


def _router(router: RouterAddress, probed: Probed) -> Step:
    name, where = f"router {router.name}", f"{router.host}:{router.port}"
    if probed.error:
        return broken(name, text=f"{where}: {probed.error}")
    if probed.days_left is not None and probed.days_left < SOON_DAYS:
        return soon(
            name,
            text=f"{where}: its certificate expires in {probed.days_left:.0f} days: renew "
            f"router/{router.name} and restart it",
        )
    return ok(name, text=f"{where}, TLS, it is {probed.name}")


def _session(installed: Installed, router: RouterAddress, heard: Echo, now: datetime) -> Step:
    who, name = installed.who, f"session {router.name}"
    if not heard.connected:
        return broken(name, text="TLS works, but no zenoh router answers: is it another program?")
    if not heard.heard:
        return broken(name, text=unknown_to_rules(who.common_name, router.name))
    if fault := clock_fault(heard.router_s, now.timestamp()):
        return broken(name, text=fault)
    return ok(name, text="its rules let this machine say and hear what it may")


def _server(alive: bool) -> Step:
    if not alive:
        return soon("server", text="the site has no pose server now: is 'pose-server run' running?")
    return ok("server", text="a pose server of the site is there")


def _rules(configuration: dict[str, object], running: dict[str, str] | None) -> Step:
    metadata = configuration["metadata"]
    installed = metadata["fleetpose"].get("rules") if isinstance(metadata, dict) else None
    if running is None:
        return soon("rules", text="the router does not tell which rules it runs")
    if running.get("rules") != installed:
        return soon("rules", text="other rules are installed than it runs: restart it")
    return ok("rules", text=f"it runs those that are installed ({installed})")


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise BundleError(f"{path}: {error.strerror}: install the bundle again") from error
