"""Why a link to a router does not come about, in words. zenoh says no more than "Timeout" or
"unable"; a connection, the handshake of TLS, and the router's alert, tell the cause.
"""

import json
import socket
import ssl
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import zenoh

CONNECT_S = 2.0  # a packet that was lost is sent again after 1 s
HANDSHAKE_S = 1.5  # as long as zenoh itself waits for an endpoint
REFUSAL_S = 0.5  # with TLS 1.3 a client that is refused learns only with its first read

_PLAIN = "what listens there speaks no TLS: a router without security, or another program"
_ALERTS = {  # what a router answers to our certificate, by the name of OpenSSL's reason
    "CERTIFICATE_EXPIRED": "it says that this machine's certificate has expired, or does not hold "
    "yet by its clock: renew it, or set the clocks",
    "UNKNOWN_CA": "it says that this machine's certificate is of another site: install the "
    "bundle of its site",
    "DECRYPT_ERROR": "it says that this machine's certificate is of an older site of the same "
    "name: install a new bundle",
    "CERTIFICATE_REQUIRED": "it says that no certificate was shown: install the bundle again",
    "BAD_CERTIFICATE": "it says that this machine's certificate is damaged, or does not hold yet: "
    "is the clock right? Else install the bundle again",
    "CERTIFICATE_UNKNOWN": "it does not accept this machine's certificate: ask for a new bundle",
    "ACCESS_DENIED": "it denies access to this machine",
    "WRONG_VERSION_NUMBER": _PLAIN,
    "RECORD_LAYER_FAILURE": _PLAIN,
    "HANDSHAKE_FAILURE": "no version of TLS in common: is that a router?",
}
_NOT_YET, _EXPIRED = 9, 10  # OpenSSL's codes of verification
_OTHER_CA = (7, 18, 19, 20, 21)
_WRONG_HOST = (62, 64)


@dataclass(frozen=True)
class Probed:
    """What a router answered.

    Attributes:
        error: why no link comes about; empty where it does.
        days_left: of the router's certificate.
        name: in the router's certificate.
    """

    error: str = ""
    days_left: float | None = None
    name: str = ""


def why_refused(endpoint: str, tls: Mapping[str, str | None]) -> str:
    """What is wrong with a link to a router that zenoh could not open; empty where nothing is
    found, or it is neither TCP nor TLS.

    Args:
        endpoint: e.g. `tls/router.internal:7447`.
        tls: zenoh's `transport/link/tls`.
    """
    if endpoint.startswith("tcp/"):
        connected = _connected(endpoint)
        if isinstance(connected, str):
            return connected
        connected.close()
        return "what listens there is no zenoh router, or one that wants TLS (--config)"
    return probe(endpoint, tls, time.time()).error


def probe(endpoint: str, tls: Mapping[str, str | None], now_s: float) -> Probed:
    """Connects to a router as zenoh would, and ends the link again; nothing is found out where the
    endpoint is not one of TLS.

    Args:
        endpoint: e.g. `tls/router.internal:7447`.
        tls: zenoh's `transport/link/tls`.
        now_s: seconds since 1970 by this machine's clock.
    """
    if not endpoint.startswith("tls/"):
        return Probed()
    connected = _connected(endpoint)
    if isinstance(connected, str):
        return Probed(connected)
    with connected:
        return _shaken(connected, _address(endpoint)[0], tls, now_s)


def _address(endpoint: str) -> tuple[str, str]:
    host, _, port = endpoint.partition("/")[2].partition("?")[0].rpartition(":")
    return host.strip("[]"), port


def _connected(endpoint: str) -> socket.socket | str:
    """A connection to where a router should be, or why there is none."""
    host, port = _address(endpoint)
    if not port.isdecimal():
        return "it names no port"
    try:
        return socket.create_connection((host, int(port)), CONNECT_S)
    except socket.gaierror:
        return f"there is no host '{host}': name it in DNS or in /etc/hosts"
    except ConnectionRefusedError:
        return "nothing listens there: is the router running?"
    except TimeoutError:
        return f"it does not answer in {CONNECT_S:.0f} s: no route, or a firewall"
    except OSError as error:
        return f"it is not reached ({error.strerror}): is the network up?"


def _shaken(plain: socket.socket, host: str, tls: Mapping[str, str | None], now_s: float) -> Probed:
    """Shakes hands over a connection."""
    where = plain.getpeername()[:2]
    try:
        context = _context(tls)
        plain.settimeout(HANDSHAKE_S)
        with context.wrap_socket(plain, server_hostname=host) as link:
            told = link.getpeercert() or {}
            if not _stays_open(link):
                return Probed("it ends the link at once: look into the router's log")
    except ssl.SSLCertVerificationError as error:
        return Probed(_refused_by_us(error, host))
    except ssl.SSLError as error:
        return Probed(_refused_by_it(error))
    except TimeoutError:
        plain.close()
        return Probed(_why_mute(*where))
    except OSError as error:
        return Probed(f"the link broke in the handshake ({error.strerror or error}): no router?")
    return _router_of(told, now_s)


def _context(tls: Mapping[str, str | None]) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    authority, certificate = tls.get("root_ca_certificate"), tls.get("connect_certificate")
    if authority:
        context.load_verify_locations(authority)
    if certificate:
        context.load_cert_chain(certificate, tls.get("connect_private_key"))
    return context


def _stays_open(link: ssl.SSLSocket) -> bool:
    """Waits for a refusal, which raises; a router says nothing before the client does."""
    link.settimeout(REFUSAL_S)
    try:
        return link.recv(1) != b""
    except TimeoutError:
        return True


def _router_of(certificate: Mapping[str, Any], now_s: float) -> Probed:
    subject = {name: value for part in certificate.get("subject", ()) for name, value in part}
    ends_s = ssl.cert_time_to_seconds(str(certificate["notAfter"]))
    return Probed(days_left=(ends_s - now_s) / 86400, name=str(subject.get("commonName", "")))


def _why_mute(host: str, port: int) -> str:
    """Why nothing comes back to the first words of TLS: a router without TLS waits for more."""
    address = f"[{host}]" if ":" in host else host
    client = {
        "mode": "client",
        "connect": {"endpoints": [f"tcp/{address}:{port}"], "timeout_ms": 0},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {"unicast": {"open_timeout": 1000}},
    }
    try:
        zenoh.open(zenoh.Config.from_json5(json.dumps(client))).close()
    except zenoh.ZError:
        return "it accepts a connection but says nothing: it is frozen, or no router"
    return (
        "it is a zenoh router that speaks no TLS: start it with the configuration of its bundle, "
        "or is this another one's port?"
    )


def _refused_by_us(error: ssl.SSLCertVerificationError, host: str) -> str:
    if error.verify_code in _OTHER_CA:
        return "it is a router of another site: its certificate is not from this site's CA"
    if error.verify_code == _NOT_YET:
        return "its certificate does not hold yet by this machine's clock: set the clock"
    if error.verify_code == _EXPIRED:
        return "its certificate has expired by this machine's clock: renew it, or set the clock"
    if error.verify_code in _WRONG_HOST:
        return (
            f"its certificate is not for '{host}': use the name that site.toml gives it, or renew "
            "the router's bundle"
        )
    return f"its certificate is not accepted ({error.verify_message})"


def _refused_by_it(error: ssl.SSLError) -> str:
    reason = error.reason or str(error)
    known = next((words for name, words in _ALERTS.items() if name in reason), None)
    return known or f"the handshake failed ({reason.lower().replace('_', ' ')})"
