"""Who is let in: addresses to listen at, hosts and origins of pages, and tokens of operators."""

import hmac
import ipaddress
import os
import re
import secrets
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fleetpose.hmi_client.errors import OperatorError
from fleetpose.protocol.keys import checked_name

LEAST_TOKEN = 16  # characters
_PORT = 8642


@dataclass(frozen=True)
class Address:
    """Where pages are served."""

    host: str
    port: int

    @classmethod
    def of(cls, text: str) -> "Address":
        """Reads `HOST:PORT`, `[::1]:8642` or a host alone.

        Raises:
            OperatorError: it is none.
        """
        found = re.fullmatch(r"(?:\[([0-9a-fA-F:.]+)\]|([^:\[\]\s]+))(?::(\d{1,5}))?", text)
        host, port = (found[1] or found[2], int(found[3] or _PORT)) if found else ("", 0)
        if not host or port > 65535:
            raise OperatorError(f"--listen {text}: write HOST:PORT, such as 127.0.0.1:{_PORT}")
        return cls(host, port)

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine reaches it."""
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return self.host == "localhost"

    @property
    def shown(self) -> str:
        """As it stands in an address line."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{host}:{self.port}"

    def open(self) -> socket.socket:
        """A socket that listens there.

        Raises:
            OperatorError: the port is taken, or the address is not this machine's.
        """
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            return socket.create_server((self.host, self.port), family=family)
        except OSError as error:
            raise OperatorError(
                f"{self.shown} cannot be listened at: {error.strerror or error}; is another "
                f"'hmi-client web' running? --listen 127.0.0.1:{self.port + 1} takes another port"
            ) from error


@dataclass(frozen=True)
class Gate:
    """What a page must bring along.

    Attributes:
        secure: whether pages come by TLS.
        hosts: `name:port`, as it may stand in the header Host.
        tokens: the operator of each token.
    """

    secure: bool
    hosts: frozenset[str]
    tokens: Mapping[str, str]

    @classmethod
    def at(
        cls, address: Address, tokens: Mapping[str, str], secure: bool, names: tuple[str, ...] = ()
    ) -> "Gate":
        """The gate of an address that is listened at.

        Args:
            address: with its real port.
            tokens: the operator of each token.
            secure: whether by TLS.
            names: more names under which pages reach it.
        """
        known = {address.shown.rpartition(":")[0], *names}
        if address.is_loopback:
            known |= {"127.0.0.1", "localhost", "[::1]"}
        else:
            known |= {socket.gethostname(), socket.getfqdn()}
        hosts = {f"{name.lower()}:{address.port}" for name in known}
        if address.port == (443 if secure else 80):
            hosts |= {name.lower() for name in known}
        return cls(secure, frozenset(hosts), tokens)

    def admits_host(self, host: str) -> bool:
        """Whether a request was meant for this address: else another site's name points here."""
        return host.lower() in self.hosts

    def admits_origin(self, origin: str) -> bool:
        """Whether a page comes from here."""
        scheme, _, host = origin.partition("://")
        return scheme == ("https" if self.secure else "http") and self.admits_host(host)

    def operator_of(self, token: object) -> str | None:
        """Whose token it is; none if nobody's. All are compared, so that time tells nothing."""
        told = token.encode() if isinstance(token, str) and token.isascii() else b""
        owners = [
            operator
            for known, operator in self.tokens.items()
            if hmac.compare_digest(known.encode(), told)
        ]
        return owners[0] if owners else None


class Allowance:
    """So many commands a second, and as many at once.

    Args:
        per_s: how many.
    """

    def __init__(self, per_s: float) -> None:
        self._per_s, self._left, self._at = per_s, per_s, time.monotonic()

    def take(self) -> bool:
        """Takes one; false if there is none left."""
        now = time.monotonic()
        self._left = min(self._left + (now - self._at) * self._per_s, self._per_s)
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


def check_reach(
    address: Address, token_file: Path | None, certificate: Path | None, key: Path | None
) -> None:
    """Beyond this machine only those get in who have a token of their own, and by TLS.

    Raises:
        OperatorError: something of that is missing; the sentence names what else can be done.
    """
    if (certificate is None) != (key is None):
        raise OperatorError("--certificate and --key belong together: give both")
    for file in (certificate, key):
        if file is not None and not file.is_file():
            raise OperatorError(f"{file} does not exist")
    if address.is_loopback or (token_file is not None and certificate is not None):
        return
    raise OperatorError(
        f"--listen {address.shown} is reached from other machines: that needs --token-file (lines "
        "'kim:TOKEN') and --certificate with --key. Or leave --listen away, and on the operator's "
        f"machine run: ssh -L {address.port}:127.0.0.1:{address.port} THIS_MACHINE"
    )


def read_tokens(path: Path) -> dict[str, str]:
    """The operators of the tokens in a file of lines `kim:TOKEN`; `#` begins a comment.

    Raises:
        OperatorError: the file cannot be read, others may read it, or a line is not right.
    """
    try:
        mode, lines = path.stat().st_mode, path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise OperatorError(f"{path} cannot be read: {error}") from error
    if mode & 0o077:
        raise OperatorError(f"{path} may be read by others: chmod 600 {path}")
    tokens: dict[str, str] = {}
    for n, line in enumerate(lines, start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, colon, token = (part.strip() for part in line.partition(":"))
        if not colon or len(token) < LEAST_TOKEN or not token.isascii():
            raise OperatorError(
                f"{path}, line {n}: write 'kim:TOKEN', the token of {LEAST_TOKEN} characters or "
                "more; 'openssl rand -hex 16' makes one"
            )
        if token in tokens:
            raise OperatorError(f"{path}, line {n}: {tokens[token]} has the same token")
        tokens[token] = checked_name(name)
    if not tokens:
        raise OperatorError(f"{path} names nobody: write lines 'kim:TOKEN'")
    return tokens


def own_token(path: Path) -> str:
    """The token of this user's pages, made once: so that open pages go on after a restart.

    Raises:
        OperatorError: it can neither be read nor written.
    """
    try:
        if path.exists() and not path.stat().st_mode & 0o077:
            token = path.read_text(encoding="ascii").strip()
            if len(token) >= LEAST_TOKEN:
                return token
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        token = secrets.token_urlsafe(24)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
            file.write(token)
    except (OSError, UnicodeDecodeError) as error:
        raise OperatorError(f"{path} cannot be used: {error}") from error
    return token
