"""Certificates of a site of a test's own: one authority, and who it vouches for."""

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

DAY = dt.timedelta(days=1)


def _name(text: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)])


@dataclass
class Authority:
    """Signs certificates into a folder."""

    folder: Path
    name: str = "authority of a test"

    def __post_init__(self) -> None:
        self._key = ec.generate_private_key(ec.SECP256R1())
        self._subject = _name(self.name)
        certificate = (
            self._builder(self._subject, self._key.public_key(), 30)
            .add_extension(x509.BasicConstraints(True, 0), True)
            .sign(self._key, hashes.SHA256())
        )
        self.folder.mkdir(parents=True, exist_ok=True)
        self.file = self._write("ca.pem", certificate.public_bytes(serialization.Encoding.PEM))

    def tls(self, who: str, days: float = 30, listens: bool = False) -> dict[str, object]:
        """The `transport/link/tls` of somebody, whose certificate and key are written."""
        key = ec.generate_private_key(ec.SECP256R1())
        usages = [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH]
        certificate = (
            self._builder(_name(who), key.public_key(), days)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), False)
            .add_extension(x509.ExtendedKeyUsage(usages), False)
            .sign(self._key, hashes.SHA256())
        )
        stem = who.replace("/", "-")
        encoding, plain = serialization.Encoding.PEM, serialization.NoEncryption()
        pkcs8 = serialization.PrivateFormat.PKCS8
        kind = "listen" if listens else "connect"
        return {
            "root_ca_certificate": str(self.file),
            "enable_mtls": True,
            f"{kind}_private_key": str(
                self._write(f"{stem}.key", key.private_bytes(encoding, pkcs8, plain))
            ),
            f"{kind}_certificate": str(
                self._write(f"{stem}.pem", certificate.public_bytes(encoding))
            ),
        }

    def _builder(
        self, subject: x509.Name, public: ec.EllipticCurvePublicKey, days: float
    ) -> x509.CertificateBuilder:
        now = dt.datetime.now(dt.UTC)
        return (
            x509.CertificateBuilder()
            .subject_name(subject)
            .issuer_name(self._subject)
            .public_key(public)
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - 2 * DAY)
            .not_valid_after(now + days * DAY)
        )

    def _write(self, name: str, content: bytes) -> Path:
        file = self.folder / name
        file.write_bytes(content)
        return file
