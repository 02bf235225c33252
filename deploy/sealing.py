"""A bundle under a password: scrypt makes the key, AES-GCM encrypts and authenticates.

The layout is `MAGIC`, 16 bytes of salt, 12 of nonce, the encrypted bundle.
"""

import hashlib
import secrets

from fleetpose.deploy.errors import BundleError

MAGIC = b"fleetpose sealed bundle 1\n"
_SALT, _NONCE = 16, 12
_N, _R, _P = 1 << 15, 8, 1  # 32 MiB and a tenth of a second for each guess


class Sealer:
    """Encrypts bundles under one password; the key is derived once, each bundle has its nonce."""

    def __init__(self, password: str) -> None:
        if not password:
            raise BundleError("an empty password protects nothing: choose one")
        self._salt = secrets.token_bytes(_SALT)
        self._key = _key(password, self._salt)

    def seal(self, bundle: bytes) -> bytes:
        from cryptography.hazmat.primitives.ciphers.aead import AESGCM

        nonce = secrets.token_bytes(_NONCE)
        return MAGIC + self._salt + nonce + AESGCM(self._key).encrypt(nonce, bundle, MAGIC)


def is_sealed(content: bytes) -> bool:
    """Whether these bytes need a password."""
    return content.startswith(MAGIC)


def opened(content: bytes, password: str) -> bytes:
    """The bundle inside.

    Raises:
        BundleError: the password is another, or the bytes are damaged.
    """
    from cryptography.exceptions import InvalidTag
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    content = content.removeprefix(MAGIC)
    salt, nonce, rest = content[:_SALT], content[_SALT : _SALT + _NONCE], content[_SALT + _NONCE :]
    try:
        return AESGCM(_key(password, salt)).decrypt(nonce, rest, MAGIC)
    except (InvalidTag, ValueError) as error:
        raise BundleError("the password is another one, or the bundle is damaged") from error


def _key(password: str, salt: bytes) -> bytes:
    return hashlib.scrypt(password.encode(), salt=salt, n=_N, r=_R, p=_P, maxmem=1 << 26, dklen=32)
