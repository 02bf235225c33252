"""Reads a bundle and judges it, before anything of it is written. No `cryptography` is needed,
unless a password is.
"""

import hashlib
import json
import ssl
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from fleetpose.deploy.archive import unpacked
from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import (
    CA,
    CERTIFICATE,
    CONFIGURATION,
    KEY,
    MANIFEST,
    Manifest,
    manifest_of,
)
from fleetpose.deploy.private_files import readable_by_others, write_file
from fleetpose.deploy.sealing import is_sealed, opened
from fleetpose.protocol.session.echo import CLOCKS_DIFFER_S

CLOCKS_DIFFER = timedelta(seconds=CLOCKS_DIFFER_S)


@dataclass(frozen=True)
class Bundle:
    """A bundle that fits together; `key` is None where the machine keeps its key to itself."""

    manifest: Manifest
    files: Mapping[str, bytes]

    @property
    def who(self) -> Identity:
        return self.manifest.identity


def read_bundle(path: Path, ask_password: Callable[[], str]) -> Bundle:
    """Opens a bundle's file.

    Raises:
        BundleError: others can read it, it is damaged, or its parts do not belong together.
    """
    content = content_of(path)
    if is_sealed(content):
        content = opened(content, ask_password())
    elif readable_by_others(path):
        raise BundleError(
            f"{path} can be read by others and holds a private key: chmod 600 {path}; if anybody "
            "else uses this machine, ask for a renewed bundle"
        )
    files = unpacked(content, str(path))
    for name in (MANIFEST, CA, CERTIFICATE, CONFIGURATION):
        if name not in files:
            raise BundleError(f"{path} is damaged (no {name} in it): fetch the bundle again")
    manifest = manifest_of(files[MANIFEST], str(path))
    _belong_together(path, manifest, files)
    return Bundle(manifest, files)


def content_of(path: Path) -> bytes:
    """Bytes of a file; one that cannot be read is a sentence."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise BundleError(f"{path}: {error.strerror}: name a bundle (*.fleetpose)") from error


def _belong_together(path: Path, manifest: Manifest, files: Mapping[str, bytes]) -> None:
    told = {CERTIFICATE: manifest.certificate_sha256, CA: manifest.ca_sha256}
    for name, digest in told.items():
        if der_sha256(files[name]) != digest:
            raise BundleError(f"{path} is damaged ({name} is not the manifest's): fetch it again")
    configured = metadata_of(files[CONFIGURATION], f"{path}: {CONFIGURATION}")
    who = manifest.identity
    if configured != (manifest.site, who.role, who.name):
        raise BundleError(
            f"{path} is put together wrongly: its manifest is {who.who}'s of site "
            f"'{manifest.site}', its configuration is not; fetch it again"
        )
    if KEY in files:
        with tempfile.TemporaryDirectory() as scratch:
            for name in (CERTIFICATE, KEY):
                write_file(Path(scratch) / name, files[name])
            if not key_fits(Path(scratch)):
                raise BundleError(f"{path} is damaged (the key is another one's): fetch it again")


def der_sha256(pem: bytes) -> str | None:
    """Names a certificate by its content; None where it is none."""
    try:
        return hashlib.sha256(ssl.PEM_cert_to_DER_cert(pem.decode("ascii").strip())).hexdigest()
    except ValueError:
        return None


def key_fits(folder: Path) -> bool:
    """Whether the key in a folder is that of the certificate beside it."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(folder / CERTIFICATE, folder / KEY)
    except (ssl.SSLError, OSError, ValueError):
        return False
    return True


def configuration_of(text: bytes, where: str) -> dict[str, Any]:
    """The zenoh configuration as we write it.

    Raises:
        BundleError: it is damaged.
    """
    try:
        configuration = json.loads(text)
        if not isinstance(configuration, dict):
            raise ValueError("no object")
    except ValueError as error:
        raise BundleError(f"{where} is damaged ({error}): install the bundle again") from error
    return configuration


def metadata_of(text: bytes, where: str) -> tuple[str, str, str]:
    """Site, role and name that a configuration tells.

    Raises:
        BundleError: it is damaged, or does not tell them.
    """
    told = configuration_of(text, where).get("metadata") or {}
    ours = told.get("fleetpose") or {}
    try:
        return ours["site"], ours["role"], ours["name"]
    except (KeyError, TypeError) as error:
        raise BundleError(f"{where} does not say whose it is: install the bundle again") from error


def check_time(manifest: Manifest, now: datetime) -> None:
    """Refuses a bundle that has expired, or that is not made yet by this machine's clock.

    Raises:
        BundleError: it is so.
    """
    if now < manifest.issued - CLOCKS_DIFFER:
        raise BundleError(
            f"this machine's clock says {now:%Y-%m-%d %H:%M} UTC, but the bundle was made at "
            f"{manifest.issued:%Y-%m-%d %H:%M}: set the clock"
        )
    if now > manifest.not_after:
        raise BundleError(
            f"the certificate of {manifest.identity.who} expired on "
            f"{manifest.not_after:%Y-%m-%d %H:%M} UTC: ask the site's keeper to renew it"
        )
