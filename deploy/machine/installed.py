"""What is installed on this machine: one folder for each bundle, below /etc/fleetpose."""

import os
from dataclasses import dataclass
from pathlib import Path

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import CA, CERTIFICATE, KEY, MANIFEST, Manifest, manifest_of

DEFAULT_ROOT = Path("/etc/fleetpose")


@dataclass(frozen=True)
class Installed:
    """A folder with a manifest that can be read."""

    folder: Path
    manifest: Manifest

    @property
    def who(self) -> Identity:
        return self.manifest.identity


def tls_files(folder: Path) -> dict[str, str | None]:
    """What a folder's owner shows to routers and trusts, as zenoh's `transport/link/tls` has it."""
    return {
        "root_ca_certificate": str(folder / CA),
        "connect_certificate": str(folder / CERTIFICATE),
        "connect_private_key": str(folder / KEY),
    }


def installed_in(folder: Path) -> Installed:
    """What a folder holds.

    Raises:
        BundleError: it holds no bundle, or a damaged manifest.
    """
    path = folder / MANIFEST
    try:
        text = path.read_bytes()
    except OSError as error:
        raise BundleError(
            f"{path}: {error.strerror}: install a bundle with 'pose-deploy install FILE'"
        ) from error
    return Installed(folder, manifest_of(text, str(path)))


def folders_below(root: Path) -> list[Path]:
    """The folders with a manifest: this one, or those in it.

    Raises:
        BundleError: one of them is closed to this user.
    """
    folders = [path for path in root.glob("*") if path.is_dir()] if root.is_dir() else []
    for folder in (root, *folders):
        if folder.exists() and not os.access(folder, os.R_OK | os.X_OK):
            raise BundleError(f"{folder} is closed to you: run it as root or as its owner")
    if (root / MANIFEST).exists():
        return [root]
    return sorted(path.parent for path in root.glob(f"*/{MANIFEST}"))


def check_place(root: Path, manifest: Manifest) -> None:
    """Refuses a bundle that does not belong on this machine.

    Raises:
        BundleError: the machine is of another site, is another robot, or has a newer bundle.
    """
    who = manifest.identity
    for folder in folders_below(root):
        there = installed_in(folder)
        if there.manifest.site != manifest.site or there.manifest.ca_sha256 != manifest.ca_sha256:
            other = "" if there.manifest.site != manifest.site else " (an older one of this name?)"
            raise BundleError(
                f"the bundle is of site '{manifest.site}', this machine of site "
                f"'{there.manifest.site}'{other}: remove {folder} first if it is to move"
            )
        if there.who.role == who.role == "robot" and there.who.name != who.name:
            raise BundleError(
                f"the bundle is robot {who.name}'s, this machine is robot {there.who.name}: "
                f"fetch {there.who.folder}.fleetpose, or remove {folder} first"
            )
        if there.who.who == who.who and there.manifest.issued > manifest.issued:
            raise BundleError(
                f"the bundle was made on {manifest.issued:%Y-%m-%d %H:%M}, the one installed is "
                f"newer ({there.manifest.issued:%Y-%m-%d %H:%M}): fetch the newest"
            )
