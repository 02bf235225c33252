"""Installs a bundle: first every file is planned, then all are written, or shown with --dry-run."""

import json
import os
import pwd
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.machine.bundle import Bundle, check_time, configuration_of, metadata_of
from fleetpose.deploy.machine.installed import check_place, installed_in
from fleetpose.deploy.machine.system_files import System, system_files
from fleetpose.deploy.manifest import CA, CERTIFICATE, CONFIGURATION, KEY, MANIFEST
from fleetpose.deploy.private_files import PRIVATE, PUBLIC, make_folder, write_file
from fleetpose.deploy.site.configuration import text_of

USER = "fleetpose"
"""Whose files they are on a machine that has this user."""


@dataclass(frozen=True)
class Planned:
    """A file to write; `keep`: one that is there stays, its owner may have edited it."""

    path: Path
    content: bytes
    mode: int = PRIVATE
    keep: bool = False

    @property
    def stays(self) -> bool:
        return self.keep and self.path.exists()


@dataclass(frozen=True)
class Plan:
    """Files of an installation, and what to type afterwards."""

    who: Identity
    folder: Path
    files: tuple[Planned, ...]
    commands: tuple[str, ...]

    def write(self, owner: int | None = None) -> None:
        """Writes everything; files of the folder belong to whom the folder belongs.

        Args:
            owner: of the folder, as a number; else who had it before, or the user `fleetpose`.
        """
        if owner is None and not self.folder.exists():
            owner = _user()
        make_folder(self.folder)
        if owner is not None and os.geteuid() == 0:
            os.chown(self.folder, owner, owner)
        for file in self.files:
            if not file.stays:
                _write(file, self.folder)


def plan_install(
    bundle: Bundle,
    root: Path,
    system: System | None = None,
    image: Path = Path("/"),
    now: datetime | None = None,
) -> Plan:
    """What installing a bundle writes.

    Args:
        bundle: that was read.
        root: folder of all that is installed, as processes of that machine will name it.
        system: what starts the processes; None writes the bundle's files alone.
        image: the file system that is written to.
        now: by this machine's clock.

    Raises:
        BundleError: the bundle has expired, or does not belong on this machine.
    """
    root = root.absolute()
    check_time(bundle.manifest, now or datetime.now(UTC))
    check_place(_below(image, root), bundle.manifest)
    folder = root / bundle.who.folder
    on_disk = _below(image, folder)
    if KEY not in bundle.files and not (on_disk / KEY).exists():
        raise BundleError(
            f"the bundle holds no key, it was made on this machine: put it at {on_disk / KEY} first"
        )
    files = [
        Planned(on_disk / name, bundle.files[name])
        for name in (KEY, CERTIFICATE, CA, MANIFEST)  # the manifest last: it vouches for the others
        if name in bundle.files
    ]
    files.insert(0, Planned(on_disk / CONFIGURATION, _in(folder, bundle.files[CONFIGURATION])))
    more, commands = system_files(bundle.manifest, folder, system)
    files += [Planned(_below(image, file.path), file.content, PUBLIC, file.keep) for file in more]
    return Plan(bundle.who, on_disk, tuple(files), commands)


def plan_rules(content: bytes, path: Path, root: Path, image: Path = Path("/")) -> Plan:
    """What installing a router's new rules writes: its configuration, and nothing secret.

    Raises:
        BundleError: they are not those of a router that is installed here.
    """
    site, role, name = metadata_of(content, str(path))
    who = Identity(role, name)
    folder = root.absolute() / who.folder
    there = installed_in(_below(image, folder))
    if role != "router" or there.manifest.site != site:
        raise BundleError(
            f"{path} is {who.who}'s of site '{site}', {folder} is {there.who.who}'s of site "
            f"'{there.manifest.site}': install the rules of that router"
        )
    file = Planned(_below(image, folder) / CONFIGURATION, _in(folder, content))
    return Plan(who, _below(image, folder), (file,), (f"systemctl restart fleetpose-{who.folder}",))


def _in(folder: Path, configuration: bytes) -> bytes:
    """A configuration whose files lie in a folder."""
    known: dict[str, Any] = configuration_of(configuration, CONFIGURATION)
    try:
        tls = known["transport"]["link"]["tls"]
        for name, value in tls.items():
            if isinstance(value, str):
                tls[name] = str(folder / Path(value).name)
    except (KeyError, AttributeError) as error:
        raise BundleError(f"the configuration has no TLS ({error}): fetch it again") from error
    return text_of(known).encode()


def _below(image: Path, path: Path) -> Path:
    """A path of a machine inside of the file system that stands for it."""
    return image / path.relative_to("/")


def _write(file: Planned, folder: Path) -> None:
    file.path.parent.mkdir(parents=True, exist_ok=True)
    write_file(file.path, file.content, file.mode)
    if file.path.parent == folder and os.geteuid() == 0:
        owner = folder.stat()
        os.chown(file.path, owner.st_uid, owner.st_gid)


def _user() -> int:
    try:
        return pwd.getpwnam(USER).pw_uid
    except KeyError:
        return 0


def described(plan: Plan) -> list[str]:
    """Each file and the commands, as a user reads them."""
    lines = [
        f"  {file.path}  {file.mode:04o}{'  (stays as it is)' if file.stays else ''}"
        for file in plan.files
    ]
    return [*lines, *(("then:", *(f"  {one}" for one in plan.commands)) if plan.commands else ())]


def as_json(plan: Plan) -> str:
    """The same for programs."""
    files = [{"path": str(file.path), "mode": f"{file.mode:04o}"} for file in plan.files]
    return json.dumps({"who": plan.who.who, "files": files, "commands": list(plan.commands)})
