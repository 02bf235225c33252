"""Why a TLS link to a router does not come about, in words, by the standard library alone.

zenoh says only that it cannot connect; the handshake itself knows the cause.
"""

import socket
import ssl
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fleetpose.deploy.manifest import CA, CERTIFICATE, KEY, RouterAddress

ANSWER_S = 3.0
REFUSAL_S = 0.4
"""With TLS 1.3 a client learns only after the handshake that it was refused."""

ALERTS = {  # what a router answers to our certificate, by the name of OpenSSL's reason
    "CERTIFICATE_EXPIRED": "it says that this machine's certificate has expired, or does not hold "
    "yet by its clock: renew it, or set the clocks",
    "UNKNOWN_CA": "it says that this machine's certificate is of another site: install the "
    "bundle of its site",
    "DECRYPT_ERROR": "it says that this machine's certificate is of an older site of the same "
    "name: install a new bundle",
    "CERTIFICATE_REQUIRED": "it says that no certificate was shown: install the bundle again",
    "BAD_CERTIFICATE": "it says that this machine's certificate is damaged: install the bundle "
    "again",
    "CERTIFICATE_UNKNOWN": "it does not accept this machine's certificate: ask for a new bundle",
    "ACCESS_DENIED": "it denies access to this machine",
    "WRONG_VERSION_NUMBER": "what listens there speaks no TLS: a router without security, or "
    "another program",
    "RECORD_LAYER_FAILURE": "what listens there speaks no TLS: a router without security, or "
    "another program",
    "HANDSHAKE_FAILURE": "no version of TLS in common: is that a router?",
}
_NOT_YET, _EXPIRED = 9, 10  # OpenSSL's codes of verification
_OTHER_CA = (7, 18, 19, 20, 21)
_WRONG_HOST = (62, 64)


@dataclass(frozen=True)
class Probed:
    """What a router answered.

    Attributes:
        error: why no link comes about; None where it does.
        days_left: of the router's certificate.
    """

    error: str | None = None
    days_left: float | None = None
    name: str = ""


def probe(router: RouterAddress, folder: Path, now_s: float) -> Probed:
    """Connects to a router as zenoh would, and ends the link again.

    Args:
        router: whom to ask.
        folder: with certificate, key and CA.
        now_s: seconds since 1970 by this machine's clock.
    """
    where = f"{router.host}:{router.port}"
    try:
        raw = socket.create_connection((router.host, router.port), ANSWER_S)
    except socket.gaierror:
        return Probed(f"there is no host '{router.host}': name it in DNS or in /etc/hosts")
    except ConnectionRefusedError:
        return Probed(f"nothing listens at {where}: is the router running?")
    except TimeoutError:
        return Probed(f"{where} does not answer in {ANSWER_S:.0f} s: no route, or a firewall")
    except OSError as error:
        return Probed(f"{where} is not reached ({error.strerror}): is the network up?")
    with raw:
        return _handshake(raw, router, folder, now_s)


def _handshake(raw: socket.socket, router: RouterAddress, folder: Path, now_s: float) -> Probed:
    try:
        context = ssl.create_default_context(cafile=str(folder / CA))
        context.load_cert_chain(folder / CERTIFICATE, folder / KEY)
        with context.wrap_socket(raw, server_hostname=router.host) as link:
            told = link.getpeercert() or {}
            if not _stays_open(link):
                return Probed("it ends the link at once: look into the router's log")
    except ssl.SSLCertVerificationError as error:
        return Probed(_refused_by_us(error, router))
    except ssl.SSLError as error:
        return Probed(_refused_by_it(error))
    except TimeoutError:
        return Probed("it accepts a connection but says nothing: it is frozen, or no router")
    except OSError as error:
        return Probed(f"the link broke in the handshake ({error.strerror or error}): no router?")
    pairs: Any = told.get("subject", ())
    subject = {name: value for part in pairs for name, value in part}
    ends_s = ssl.cert_time_to_seconds(str(told["notAfter"]))
    return Probed(days_left=(ends_s - now_s) / 86400, name=str(subject.get("commonName", "")))


def _stays_open(link: ssl.SSLSocket) -> bool:
    """Waits for a refusal, which raises; a router says nothing before the client does."""
    link.settimeout(REFUSAL_S)
    try:
        return link.recv(1) != b""
    except TimeoutError:
        return True


def _refused_by_us(error: ssl.SSLCertVerificationError, router: RouterAddress) -> str:
    if error.verify_code in _OTHER_CA:
        return "it is a router of another site: its certificate is not from this site's CA"
    if error.verify_code == _NOT_YET:
        return "its certificate does not hold yet by this machine's clock: set the clock"
    if error.verify_code == _EXPIRED:
        return "its certificate has expired by this machine's clock: renew it, or set the clock"
    if error.verify_code in _WRONG_HOST:
        return (
            f"its certificate is not for '{router.host}': use the name that site.toml gives it, "
            "or renew the router's bundle"
        )
    return f"its certificate is not accepted ({error.verify_message})"


def _refused_by_it(error: ssl.SSLError) -> str:
    reason = error.reason or str(error)
    known = next((words for name, words in ALERTS.items() if name in reason), None)
    return known or f"the handshake failed ({reason.lower().replace('_', ' ')})"
