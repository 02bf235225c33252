"""A site on the loopback interface: its folder, what is installed of it, and sessions of its
members.
"""

import json
import random
import shutil
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.deploy.machine.bundle import read_bundle
from fleetpose.deploy.machine.install import plan_install
from fleetpose.deploy.manifest import CERTIFICATE, CONFIGURATION, KEY, RouterAddress
from fleetpose.deploy.site.certificates import Issued
from fleetpose.deploy.site.folder import Site
from fleetpose.deploy.site.issuing import make_site
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import SessionSettings, open_session

Change = Callable[[dict[str, Any]], object]


def no_password() -> str:
    """Bundles of this site have none."""
    raise AssertionError("no password is needed")


def listening_port() -> int:
    """A free port of 127.0.0.1 from below those that are given to clients: who asks again and again
    for a router that is not there may else be given its port, and so keep the router from it.
    """
    while True:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", random.randrange(20_000, 30_000)))
            return probe.getsockname()[1]


class Field:
    """A site with robots, operators and an observer, each installed on a machine of its own.

    Args:
        folder: for everything.
        site: its name.
        routers: names; each listens on a free port of `host`.
        host: where they are.
    """

    def __init__(
        self,
        folder: Path,
        site: str = "demo",
        robots: tuple[str, ...] = ("r1", "r2", "r3"),
        operators: tuple[str, ...] = ("anna", "ben"),
        observers: tuple[str, ...] = ("wall",),
        routers: tuple[str, ...] = ("a",),
        host: str = "127.0.0.1",
    ) -> None:
        self.folder = folder
        told = Site(
            site=site,
            routers={name: f"{host}:{listening_port()}" for name in routers},
            robots=robots,
            operators=operators,
            observers=observers,
        )
        self.keeper, _, _ = make_site(folder / "site", told)
        self.keys = Keys(site)

    @property
    def site(self) -> Site:
        """What `site.toml` says."""
        return self.keeper.folder.site

    def router(self, name: str = "a") -> RouterAddress:
        """Where it listens."""
        return next(one for one in self.site.addresses() if one.name == name)

    def bundle(self, who: str) -> Path:
        """The file that was made for somebody."""
        return self.keeper.folder.bundle(self.site.member(who))

    def install(self, who: str) -> Path:
        """Installs a bundle on its own machine; the folder that it is in."""
        root = self.folder / "machines" / who.replace("/", "-")
        plan = plan_install(read_bundle(self.bundle(who), no_password), root)
        plan.write()
        return plan.folder

    def configuration(self, who: str) -> Path:
        """Of zenoh, on somebody's machine."""
        return self.install(who) / CONFIGURATION

    def with_certificate(self, name: str, issued: Issued, like: str = "robot/r1") -> Path:
        """The folder of a machine that has another certificate than it should."""
        folder = self.folder / "forged" / name
        there = self.install(like)
        shutil.copytree(there, folder)
        (folder / CERTIFICATE).write_bytes(issued.pem)
        (folder / KEY).write_bytes(issued.key_pem or b"")
        text = (folder / CONFIGURATION).read_text().replace(str(there), str(folder))
        (folder / CONFIGURATION).write_text(text)
        return folder

    def open(self, who: str, change: Change | None = None) -> zenoh.Session:
        """A raw session with somebody's certificate."""
        return opened(self.configuration(who), change)

    def start_router(self, name: str = "a") -> zenoh.Session:
        """A router in this process, from its bundle."""
        config = self.configuration(f"router/{name}")
        return open_session(SessionSettings(config_file=config))


def opened(configuration: Path, change: Change | None = None) -> zenoh.Session:
    """A raw session; its configuration may be changed first."""
    told = json.loads(configuration.read_text())
    if change is not None:
        change(told)
    return zenoh.open(zenoh.Config.from_json5(json.dumps(told)))
