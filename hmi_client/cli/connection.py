"""How the commands reach the fleet: the options they share, and a connected session."""

import getpass
import re
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fleetpose.hmi_client.cli.options import Given, given_before, given_site
from fleetpose.hmi_client.errors import NoServerError, OperatorError
from fleetpose.hmi_client.settings import ClientSettings
from fleetpose.protocol.keys import checked_name

if TYPE_CHECKING:
    from fleetpose.hmi_client.model.session import OperatorSession
    from fleetpose.hmi_client.network.client import Client
    from fleetpose.hmi_client.network.shared import SharedLink
    from fleetpose.hmi_client.network.update_log import UpdateLog
    from fleetpose.protocol.recording.file import Recorder
    from fleetpose.protocol.transport import Link

SERVER_TIMEOUT_S = 5.0

Connect = Annotated[
    list[str],
    typer.Option(
        help="endpoint of the router, repeatable",
        callback=given_before,
    ),
]
Site = Annotated[
    str,
    typer.Option(help="name of the site", callback=given_site),
]
Sites = Annotated[
    str,
    typer.Option(help="name of the site, or of several: a,b", callback=given_site),
]
Config = Annotated[
    Path | None,
    typer.Option(
        help="zenoh configuration (JSON5), replaces --connect; it may say who you are",
        callback=given_before,
    ),
]
Operator = Annotated[
    str,
    typer.Option(
        help="who you are [default: the user's name]",
        callback=given_before,
    ),
]
DEFAULT_CONNECT = ["tcp/127.0.0.1:7447"]
DEFAULT_SITE = "demo"


@dataclass(frozen=True)
class Connection:
    """Where the fleet is and who operates."""

    connect: tuple[str, ...]
    site: str
    config: Path | None
    operator: str
    looks_only: bool = False

    @classmethod
    def of(cls, connect: list[str], site: str, config: Path | None, operator: str) -> "Connection":
        """From the options; a configuration may say whose it is, and then knows site and operator.

        Raises:
            EndpointError: the configuration cannot be used, or belongs to somebody else.
            OperatorError: several sites are named.
        """
        if "," in site:
            raise OperatorError(
                f"--site {site}: this command works at one site, name one of them; "
                f"screen, watch and status follow several"
            )
        identity = None
        if config is not None:
            from fleetpose.protocol.session.identity import identity_in

            identity = identity_in(config, ClientSettings.roles)
        if identity is None or config is None:
            return cls(tuple(connect), site, config, operator or default_operator())
        identity.settle("--site", site if isinstance(site, Given) else None, identity.site, config)
        identity.settle("--operator", operator or None, identity.name, config)
        looks_only = identity.role == "observer"
        return cls(tuple(connect), identity.site, config, identity.name, looks_only)

    @classmethod
    def each(
        cls, connect: list[str], sites: str, config: Path | None, operator: str
    ) -> "tuple[Connection, ...]":
        """One for each of several sites, `a,b`.

        Raises:
            EndpointError: the configuration cannot be used, or belongs to somebody else: one that
                says whose it is belongs to one site.
        """
        if "," not in sites:
            return (cls.of(connect, sites, config, operator),)
        names = dict.fromkeys(name.strip() for name in sites.split(","))
        return tuple(cls.of(connect, Given(checked_name(name)), config, operator) for name in names)

    def session(
        self, threshold_m: float | None = None, kept: "UpdateLog | None" = None
    ) -> "OperatorSession":
        """What is known and what the operator does; of an observer, who only looks."""
        from fleetpose.hmi_client.model.onlooker import Onlooker
        from fleetpose.hmi_client.model.session import OperatorSession

        kind = Onlooker if self.looks_only else OperatorSession
        return kind(self.operator, threshold_m=threshold_m, kept=kept)

    def client(
        self,
        session: "OperatorSession",
        timeout_s: float = SERVER_TIMEOUT_S,
        recorder: "Recorder | None" = None,
        each_pose: bool = True,
        shared: "SharedLink | None" = None,
    ) -> "Client":
        """A client that is not started yet; opening the link gives up after the timeout. With a
        recorder, all that passes is recorded. It may share the connection of other sites' clients.
        """
        from fleetpose.hmi_client.network.client import Client
        from fleetpose.hmi_client.recording.link import RecordedLink
        from fleetpose.protocol.keys import Keys
        from fleetpose.protocol.transport import Link

        def open_link() -> Link:
            link = shared.open() if shared is not None else self.open_link(timeout_s)
            return link if recorder is None else RecordedLink(link, recorder)

        return Client(session, Keys(self.site), open_link, each_pose)

    def open_link(self, timeout_s: float) -> "Link":
        """Connects to a router.

        Raises:
            UnreachableError: there is none.
        """
        from fleetpose.protocol.transport import Link, SessionSettings, open_session

        settings = SessionSettings(
            connect=self.connect, config_file=self.config, timeout_s=timeout_s
        )
        return Link(open_session(settings))

    @contextmanager
    def server(self, patient: bool = False) -> Iterator["OperatorSession"]:
        """A session that a server has been heard in.

        Args:
            patient: wait for router and server for ever, and say so.

        Raises:
            NoServerError: none was heard within 5 seconds.
        """
        with self.client_of_server(patient) as client:
            yield client.session

    @contextmanager
    def client_of_server(self, patient: bool = False) -> Iterator["Client"]:
        """The same with the client around the session."""
        from fleetpose.protocol.session.opening import FOR_EVER

        session = self.session()
        with self.client(session, FOR_EVER if patient else SERVER_TIMEOUT_S) as client:
            if not session.wait_change({}, ("fleet",), SERVER_TIMEOUT_S):
                absent = self.no_server()
                if not patient:
                    raise NoServerError(absent)
                typer.echo(f"{absent} Waiting for it.", err=True)
                while not session.wait_change({}, ("fleet",), SERVER_TIMEOUT_S):
                    pass
            yield client

    def no_server(self) -> str:
        """What to say where none was heard."""
        where = self.config or ", ".join(self.connect)
        return (
            f"no pose server of site '{self.site}' answered at {where} in "
            f"{SERVER_TIMEOUT_S:.0f} s; is 'pose-server run' running there?"
        )


@contextmanager
def servers(sites: tuple[Connection, ...], patient: bool) -> "Iterator[list[OperatorSession]]":
    """The sessions of several sites over one connection.

    Args:
        sites: of one operator.
        patient: wait for the router for ever, and say whose server is not there; it may come later.

    Raises:
        NoServerError: a server was not heard within 5 seconds.
    """
    from fleetpose.hmi_client.network.shared import SharedLink
    from fleetpose.protocol.session.opening import FOR_EVER

    timeout_s = FOR_EVER if patient else SERVER_TIMEOUT_S
    shared = SharedLink(lambda: sites[0].open_link(timeout_s))
    with ExitStack() as opened:
        sessions = [where.session() for where in sites]
        for where, session in zip(sites, sessions, strict=True):
            opened.enter_context(where.client(session, shared=shared))
        end = time.monotonic() + SERVER_TIMEOUT_S
        for where, session in zip(sites, sessions, strict=True):
            if session.wait_change({}, ("fleet",), max(end - time.monotonic(), 0.0)):
                continue
            if not patient:
                raise NoServerError(where.no_server())
            typer.echo(f"{where.no_server()} Waiting for it.", err=True)
        yield sessions


def default_operator() -> str:
    """The user's name as a chunk of a key."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # no entry in the password file, as in some containers
        user = ""
    return re.sub(r"[^a-z0-9_-]", "-", user.lower())[:32] or "operator"
