"""A bundle as bytes: a tar.gz of a few small files by name, nothing else in it."""

import gzip
import io
import tarfile
import zlib
from collections.abc import Mapping

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.manifest import CA, CERTIFICATE, CONFIGURATION, KEY, MANIFEST

MEMBERS = (MANIFEST, CA, CERTIFICATE, KEY, CONFIGURATION)
LARGEST = 16 << 20
"""Bytes of all files together, unpacked; a router's rules for 300 robots take one."""


def packed(files: Mapping[str, bytes]) -> bytes:
    """The files as a tar.gz; names and modes are ours, not those of this machine."""
    out = io.BytesIO()
    with (
        gzip.GzipFile(fileobj=out, mode="wb", compresslevel=6, mtime=0) as squeezed,
        tarfile.open(fileobj=squeezed, mode="w", format=tarfile.USTAR_FORMAT) as archive,
    ):
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size, member.mode = len(content), 0o600
            archive.addfile(member, io.BytesIO(content))
    return out.getvalue()


def unpacked(content: bytes, where: str) -> dict[str, bytes]:
    """The files of a bundle, by name.

    Only plain files of known names are taken: what would be written elsewhere, or be more than a
    file, makes the whole bundle suspect.

    Raises:
        BundleError: it is damaged, too large, or holds something else.
    """
    try:
        plain = _bounded(content)
        with tarfile.open(fileobj=io.BytesIO(plain), mode="r:") as archive:
            return {member.name: _file(archive, member) for member in archive}
    except (tarfile.TarError, OSError, EOFError, zlib.error) as error:
        raise BundleError(f"{where} is damaged ({error}): fetch the bundle again") from error


def _bounded(content: bytes) -> bytes:
    with gzip.GzipFile(fileobj=io.BytesIO(content)) as squeezed:
        plain = squeezed.read(LARGEST + 1)
    if len(plain) > LARGEST:
        raise BundleError(f"this is no bundle: it unpacks to more than {LARGEST >> 20} MiB")
    return plain


def _file(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    file = archive.extractfile(member) if member.isreg() else None
    if file is None or member.name not in MEMBERS:
        raise BundleError(
            f"'{member.name}' does not belong in a bundle: do not install it, fetch it again "
            "from the site's keeper"
        )
    return file.read()
