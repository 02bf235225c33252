"""Why a TLS link to a router does not come about, in words. zenoh says no more than "Timeout"; the
router's alert tells the cause.
"""

import socket
import ssl
from collections.abc import Mapping

PROBE_S = 2.0
_ALERTS = {
    "CERTIFICATE_EXPIRED": "it says that this certificate has expired, or is not valid yet, by its "
    "clock",
    "UNKNOWN_CA": "it says that this certificate is of another site",
    "DECRYPT_ERROR": "it says that this certificate is of another authority with this site's name",
    "CERTIFICATE_REQUIRED": "it asks for a certificate",
    "BAD_CERTIFICATE": "it does not accept this certificate: is it valid yet, is the clock right?",
    "WRONG_VERSION_NUMBER": "what listens there speaks no TLS",
}
_VERIFIED = {
    9: "its certificate is not valid yet by this machine's clock: is the clock right?",
    10: "its certificate has expired by this machine's clock: is the clock right?",
    18: "it is the router of another site",
    19: "it is the router of another site",
    20: "it is the router of another site",
    62: "its certificate names another host",
    64: "its certificate names another host",
}


def why_refused(endpoint: str, tls: Mapping[str, str | None]) -> str:
    """What is wrong with a link to a router; empty where nothing is found, or it is no TLS.

    Args:
        endpoint: e.g. `tls/router.internal:7447`.
        tls: zenoh's `transport/link/tls`.
    """
    protocol, _, address = endpoint.partition("/")
    host, _, port = address.partition("?")[0].rpartition(":")
    if protocol != "tls" or not port.isdigit():
        return ""
    try:
        context = _context(tls)
        with socket.create_connection((host.strip("[]"), int(port)), PROBE_S) as plain:
            return _handshake(plain, host, context)
    except socket.gaierror:
        return f"there is no host '{host}'"
    except ConnectionRefusedError:
        return "nothing listens there"
    except TimeoutError:
        return "it does not answer: a firewall, no route, or a frozen router"
    except ssl.SSLCertVerificationError as error:
        return _VERIFIED.get(error.verify_code, f"its certificate: {error.verify_message}")
    except ssl.SSLError as error:
        return _in_words(error)
    except OSError as error:
        return error.strerror or type(error).__name__


def _context(tls: Mapping[str, str | None]) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    authority, certificate = tls.get("root_ca_certificate"), tls.get("connect_certificate")
    if authority:
        context.load_verify_locations(authority)
    if certificate:
        context.load_cert_chain(certificate, tls.get("connect_private_key"))
    return context


def _handshake(plain: socket.socket, host: str, context: ssl.SSLContext) -> str:
    with context.wrap_socket(plain, server_hostname=host.strip("[]")) as link:
        link.settimeout(0.5)  # of TLS 1.3 a client that is refused learns with the first read
        try:
            return "" if link.recv(1) else "it closes the link at once"
        except TimeoutError:
            return ""


def _in_words(error: ssl.SSLError) -> str:
    reason = error.reason or str(error)
    found = (words for alert, words in _ALERTS.items() if alert in reason)
    return next(found, f"TLS fails: {reason}")
