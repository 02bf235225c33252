"""A site's certificate authority, and the certificates that it issues (X.509, ECDSA on P-256)."""

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from fleetpose.deploy.errors import SiteError
from fleetpose.deploy.identity import Identity

CA_DAYS = 3650
BACKDATED = timedelta(minutes=5)
"""Clocks of a site may differ by so much."""

PublicKey = ec.EllipticCurvePublicKey


@dataclass(frozen=True)
class Issued:
    """A certificate, with its key unless that was made elsewhere.

    Attributes:
        der_sha256: names the certificate.
        serial: hexadecimal.
    """

    pem: bytes
    key_pem: bytes | None
    not_before: datetime
    not_after: datetime
    der_sha256: str
    serial: str


class Authority:
    """Signs the certificates of one site, and of no other."""

    def __init__(self, site: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey):
        self.site, self._certificate, self._key = site, certificate, key

    @classmethod
    def make(cls, site: str, now: datetime | None = None) -> Self:
        """A new one, that holds for ten years."""
        now = now or datetime.now(UTC)
        key = _new_key()
        name = _name(site, f"fleetpose site {site}")
        certificate = (
            _builder(name, name, key.public_key(), now, timedelta(days=CA_DAYS))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs_certificates=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        return cls(site, certificate, key)

    @classmethod
    def load(cls, site: str, certificate: bytes, key: bytes) -> Self:
        """From PEM.

        Raises:
            SiteError: they are damaged.
        """
        try:
            loaded = serialization.load_pem_private_key(key, None)
            known = x509.load_pem_x509_certificate(certificate)
        except ValueError as error:
            raise SiteError(f"the CA of site '{site}' is damaged: restore ca/ ({error})") from error
        if not isinstance(loaded, ec.EllipticCurvePrivateKey):
            raise SiteError(f"the CA of site '{site}' has a key of another kind: restore ca/")
        return cls(site, known, loaded)

    @property
    def pem(self) -> bytes:
        return self._certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        return _key_pem(self._key)

    @property
    def fingerprint(self) -> str:
        """SHA-256 of its certificate, hexadecimal."""
        return self._certificate.fingerprint(hashes.SHA256()).hex()

    def issue(
        self,
        who: Identity,
        days: float,
        host: str | None = None,
        request: bytes | None = None,
        now: datetime | None = None,
    ) -> Issued:
        """A certificate for somebody.

        Args:
            who: its subject.
            days: that it holds; negative for one that has expired.
            host: name or address that a router is reached at; others serve nobody.
            request: a signing request (PEM) of a machine that keeps its key to itself; only its
                public key is heeded.
            now: when it begins to hold.

        Raises:
            SiteError: the request is damaged, or of another kind of key.
        """
        now = now or datetime.now(UTC)
        key = None if request is not None else _new_key()
        public = key.public_key() if key is not None else _requested(request or b"")
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
        usages += [ExtendedKeyUsageOID.SERVER_AUTH] if host else []
        subject = _name(self.site, who.common_name)
        certificate = (
            _builder(subject, self._certificate.subject, public, now, timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs_certificates=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
            .add_extension(self._alternative_names(who, host), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()),
                critical=False,
            )
            .sign(self._key, hashes.SHA256())
        )
        return Issued(
            certificate.public_bytes(serialization.Encoding.PEM),
            None if key is None else _key_pem(key),
            certificate.not_valid_before_utc,
            certificate.not_valid_after_utc,
            certificate.fingerprint(hashes.SHA256()).hex(),
            f"{certificate.serial_number:x}",
        )

    def _alternative_names(self, who: Identity, host: str | None) -> x509.SubjectAlternativeName:
        names: Sequence[x509.GeneralName]
        if host is None:
            names = [x509.UniformResourceIdentifier(f"fleetpose://{self.site}/{who.who}")]
        else:
            try:
                names = [x509.IPAddress(ipaddress.ip_address(host))]
            except ValueError:
                names = [x509.DNSName(host)]
        return x509.SubjectAlternativeName(names)


def _requested(request: bytes) -> PublicKey:
    try:
        asked = x509.load_pem_x509_csr(request)
    except ValueError as error:
        raise SiteError(f"the signing request is damaged ({error}): make it again") from error
    key = asked.public_key()
    if not asked.is_signature_valid:
        raise SiteError("the signing request is not signed by its own key: make it again")
    if not isinstance(key, ec.EllipticCurvePublicKey):
        raise SiteError("the signing request is not of an ECDSA key: make one on P-256")
    return key


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: PublicKey,
    now: datetime,
    lasts: timedelta,
) -> x509.CertificateBuilder:
    begins = min(now, now + lasts - timedelta(days=1)) - BACKDATED
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begins)
        .not_valid_after(now + lasts)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _name(site: str, common_name: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, f"fleetpose {site}"),
            x509.NameAttribute(NameOID.COMMON_NAME, common_name),
        ]
    )


def _usage(signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _new_key() -> ec.EllipticCurvePrivateKey:
    return ec.generate_private_key(ec.SECP256R1())


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
