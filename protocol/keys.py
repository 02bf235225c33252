"""Key expressions are built and parsed here and nowhere else.

Every key begins with `fleet/<site>/`. Names of sites, robots and operators are `[a-z0-9_-]{1,32}`.
"""

import re
from dataclasses import dataclass

from fleetpose.protocol.errors import EndpointError, NameRefusedError

NAME_PATTERN = r"^[a-z0-9_-]{1,32}$"
_BY_PORT = ("tcp", "tls", "quic", "udp", "ws")  # zenoh's links to HOST:PORT
_OTHERS = ("unixsock-stream", "unixpipe", "serial", "vsock")
_LAST_PORT = 65535
_NAME = re.compile(NAME_PATTERN)
EVERY_SERVER = "fleet/*/server/alive/*"
"""The tokens of the servers of all sites."""


def checked_name(name: str) -> str:
    """Returns the name if it may be a chunk of a key.

    Raises:
        NameRefusedError: it is empty, longer than 32 or holds more than a-z, 0-9, _ and -.
    """
    if not _NAME.fullmatch(name):
        raise NameRefusedError(f"'{name}' is no name: use 1 to 32 of a-z, 0-9, '_' and '-'")
    return name


def checked_endpoint(text: str) -> str:
    """Returns the endpoint if it is written as zenoh reads them.

    Raises:
        EndpointError: it is not.
    """
    protocol, slash, address = text.partition("/")
    if protocol and slash and address:
        _check_address(protocol, address, text)
    else:
        meant = text.strip("/") or "127.0.0.1"
        port = "" if ":" in meant else ":7447"
        raise EndpointError(
            f"'{text}' is no endpoint: write PROTOCOL/ADDRESS:PORT, e.g. tcp/{meant}{port}"
        )
    return text


def _check_address(protocol: str, address: str, text: str) -> None:
    if protocol not in (*_BY_PORT, *_OTHERS):
        raise EndpointError(f"'{text}' is no endpoint: '{protocol}' is no protocol, write tcp/...")
    host, _, port = re.split(r"[?#]", address, maxsplit=1)[0].rpartition(":")
    if protocol in _BY_PORT and not (host and port.isdecimal() and int(port) <= _LAST_PORT):
        raise EndpointError(
            f"'{text}' is no endpoint: it needs a port from 1 to {_LAST_PORT}, "
            f"e.g. {protocol}/{host or address}:7447"
        )


def new_epoch() -> str:
    """A random name for one life of a process; epochs are compared for equality only."""
    import secrets

    return secrets.token_hex(6)


@dataclass(frozen=True)
class Keys:
    """The keys of one site."""

    site: str = "demo"

    def __post_init__(self) -> None:
        checked_name(self.site)

    @property
    def root(self) -> str:
        return f"fleet/{self.site}"

    def camera(self, robot: str) -> str:
        return f"{self.root}/robot/{robot}/camera"

    def cloud(self, robot: str) -> str:
        return f"{self.root}/robot/{robot}/cloud"

    def image(self, robot: str) -> str:
        return f"{self.root}/robot/{robot}/image"

    def view(self, robot: str) -> str:
        return f"{self.root}/robot/{robot}/view"

    def odometry(self, robot: str) -> str:
        return f"{self.root}/robot/{robot}/odometry"

    def robot_alive(self, robot: str, epoch: str) -> str:
        return f"{self.root}/robot/{robot}/alive/{epoch}"

    def pose(self, robot: str) -> str:
        return f"{self.root}/pose/{robot}"

    @property
    def poses(self) -> str:
        return f"{self.root}/pose/**"

    def heard(self, robot: str) -> str:
        return f"{self.root}/heard/{robot}"

    def denials(self, router: str) -> str:
        return f"{self.root}/router/{router}/denials"

    @property
    def relative(self) -> str:
        return f"{self.root}/server/relative"

    @property
    def why(self) -> str:
        return f"{self.root}/server/why"

    @property
    def server_view(self) -> str:
        return f"{self.root}/server/view"

    def alignment(self, i: str, j: str) -> str:
        return f"{self.root}/pair/{i}/{j}/alignment"

    def correspondences(self, i: str, j: str) -> str:
        return f"{self.root}/pair/{i}/{j}/correspondences"

    def receipts(self, operator: str) -> str:
        return f"{self.root}/operator/{operator}/receipts"

    def updates(self, operator: str) -> str:
        return f"{self.root}/operator/{operator}/correspondences"

    def selection(self, operator: str) -> str:
        return f"{self.root}/operator/{operator}/selection"

    @property
    def state(self) -> str:
        return f"{self.root}/fleet/state"

    @property
    def status(self) -> str:
        return f"{self.root}/server/status"

    def server_alive(self, epoch: str) -> str:
        return f"{self.root}/server/alive/{epoch}"

    def check(self, role: str, name: str, nonce: str) -> str:
        return f"{self.root}/check/{role}/{name}/{nonce}"

    def chunks(self, key: str) -> list[str]:
        """The chunks of a key behind `fleet/<site>/`, e.g. `["robot", "r7", "cloud"]`.

        Raises:
            NameRefusedError: the key belongs to another site, or a chunk is no name.
        """
        prefix = self.root + "/"
        if not key.startswith(prefix):
            raise NameRefusedError(f"key '{key}' is not of site '{self.site}'")
        return [checked_name(chunk) for chunk in key[len(prefix) :].split("/")]


def site_of(key: str) -> str:
    """The site of any key."""
    return key.split("/")[1]


RobotPair = tuple[str, str]


def ordered_pair(a: str, b: str) -> RobotPair:
    """A pair is named once, in the order of its names."""
    return (a, b) if a < b else (b, a)
