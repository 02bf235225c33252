"""The zenoh configuration of a session: written here, or a file that `pose-deploy` or a person
wrote, checked before anything is opened.
"""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.protocol.errors import EndpointError
from fleetpose.protocol.keys import checked_endpoint
from fleetpose.protocol.session.probe import why_refused
from fleetpose.protocol.text import one_line, without_source

OPEN_TIMEOUT_MS = 1500  # for one endpoint: the first of two may swallow packets
_ZENOH_OPEN_TIMEOUT_MS = 10_000  # what zenoh has where a file says nothing
_TLS = "transport/link/tls"
_TLS_FILES = (
    "root_ca_certificate",
    *("listen_private_key", "listen_certificate"),
    *("connect_private_key", "connect_certificate"),
)


@dataclass(frozen=True)
class Configuration:
    """What zenoh is opened with.

    Attributes:
        zenoh: for `zenoh.open`.
        mode: client, peer or router.
        endpoints: that are connected to; of a router without any, those it listens on.
    """

    zenoh: zenoh.Config
    mode: str
    endpoints: tuple[str, ...]

    @property
    def is_client(self) -> bool:
        """Whether it needs a router."""
        return self.mode == "client"

    def why_unreachable(self) -> str:
        """What is wrong with the links to its routers, where that can be found out: by TCP and TLS.
        It may take some seconds; all are asked at once.
        """
        if not self.endpoints:
            return ""
        ask = partial(why_refused, tls=self.get(_TLS) or {})
        with ThreadPoolExecutor(len(self.endpoints)) as pool:
            found = list(pool.map(ask, self.endpoints))
        if len(set(found)) == 1:
            return found[0]
        pairs = zip(self.endpoints, found, strict=True)
        return "; ".join(f"{one}: {why}" for one, why in pairs if why)

    def get(self, key: str) -> Any:
        """A value of the configuration."""
        return json.loads(self.zenoh.get_json(key))


def written(connect: tuple[str, ...], listen: tuple[str, ...]) -> Configuration:
    """A client of a router, or a router where `listen` names endpoints.

    Raises:
        EndpointError: an endpoint is not as zenoh reads it.
    """
    for endpoint in connect + listen:
        checked_endpoint(endpoint)
    config = zenoh.Config()
    for key, value in {
        "mode": "router" if listen else "client",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
        "connect/retry": {"period_init_ms": 200, "period_max_ms": 1000},
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": 2000,
        "timestamping/enabled": True,
    }.items():
        _set(config, key, value)
    return _judged(config)


def read(file: Path) -> Configuration:
    """The configuration in a file (JSON5).

    Raises:
        EndpointError: it cannot be read, or a file that it names for TLS cannot.
    """
    if not file.is_file():
        raise EndpointError(f"the zenoh configuration {file} does not exist")
    try:
        config = zenoh.Config.from_file(str(file))
    except zenoh.ZError as error:
        reason = one_line(without_source(str(error)))
        raise EndpointError(f"the zenoh configuration {file} cannot be read: {reason}") from error
    for name in _TLS_FILES:
        named = json.loads(config.get_json(f"{_TLS}/{name}"))
        if named is not None:
            _check_readable(Path(named), f"{name} of the zenoh configuration {file}")
    return _judged(config)


def _judged(config: zenoh.Config) -> Configuration:
    """A client asks all its endpoints once each time that it is opened: zenoh's own waiting (a
    `connect/timeout_ms` above 0) asks the first endpoint for ever while that is dead.
    """
    mode = json.loads(config.get_json("mode")) or "peer"
    connect, listen = (_endpoints(config, which, mode) for which in ("connect", "listen"))
    if mode == "client":
        _set(config, "connect/timeout_ms", 0)
        timeout = "transport/unicast/open_timeout"
        if json.loads(config.get_json(timeout)) == _ZENOH_OPEN_TIMEOUT_MS:
            _set(config, timeout, OPEN_TIMEOUT_MS)
    return Configuration(config, mode, connect or (listen if mode == "router" else ()))


def _endpoints(config: zenoh.Config, which: str, mode: str) -> tuple[str, ...]:
    """The addresses, without the settings of single links."""
    found = json.loads(config.get_json(f"{which}/endpoints")) or []
    found = found.get(mode, []) if isinstance(found, dict) else found
    return tuple(str(one).partition("#")[0] for one in found)


def _check_readable(file: Path, what: str) -> None:
    try:
        file.open("rb").close()
    except OSError as error:
        raise EndpointError(f"{what}: {file} cannot be read: {error.strerror}") from error


def _set(config: zenoh.Config, key: str, value: Any) -> None:
    config.insert_json5(key, json.dumps(value))
