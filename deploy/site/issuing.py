"""What the site's keeper does: make a site, add, renew, revoke. Files are the result of each."""

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fleetpose.deploy.archive import packed, unpacked
from fleetpose.deploy.errors import SiteError
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
from fleetpose.deploy.private_files import write_file
from fleetpose.deploy.sealing import Sealer, is_sealed
from fleetpose.deploy.site.certificates import Authority, Issued
from fleetpose.deploy.site.configuration import (
    client_configuration,
    router_configuration,
    rules_hash,
    text_of,
)
from fleetpose.deploy.site.folder import HEALTH, Site, SiteFolder
from fleetpose.deploy.site.limits import limits
from fleetpose.deploy.site.rules import access_control
from fleetpose.protocol.text import release

DAYS = 90.0


@dataclass(frozen=True)
class Bundled:
    """A bundle that was written."""

    who: Identity
    path: Path
    not_after: datetime

    def __str__(self) -> str:
        size = f"{self.path.stat().st_size / 1000:.1f} kB"
        return f"{self.path} ({size}, until {self.not_after:%Y-%m-%d})"


@dataclass
class Written:
    """What a command changed.

    Attributes:
        rules: routers whose rules are other than before; they must be installed and restarted.
    """

    bundles: list[Bundled] = field(default_factory=list)
    rules: list[str] = field(default_factory=list)


class Keeper:
    """Issues for one site.

    Args:
        folder: the site's.
        sealer: where bundles are to be under a password.
    """

    def __init__(self, folder: SiteFolder, sealer: Sealer | None = None) -> None:
        self.folder, self._sealer = folder, sealer
        self._authority = folder.authority()
        self._configurations: dict[str, dict[str, Any]] = {}

    @property
    def fingerprint(self) -> str:
        """Of the site's certificate authority."""
        return self._authority.fingerprint

    def start(self, days: float = DAYS) -> Written:
        """The first bundles of a new site: of the server, the routers, and who checks them."""
        return self._issue_all(self.folder.site.members(), days)

    def add(
        self, role: str, names: Sequence[str], days: float = DAYS, request: bytes | None = None
    ) -> Written:
        """Gives new members their bundles, and all routers their rules.

        Raises:
            SiteError: one of them is there already, or several are to share a key.
        """
        if request is not None and len(names) != 1:
            raise SiteError("--request is the key of one machine: name one")
        there = {who.who for who in self.folder.site.members()}
        new = [Identity(role, name) for name in dict.fromkeys(names)]
        for who in new:
            if who.who in there:
                raise SiteError(
                    f"{who.who} is there already: 'pose-deploy renew' gives a new bundle"
                )
        site = self.folder.site.with_names(role, names)
        for who in new:
            site = site.with_generation(who.of_generation(self._next_generation(who)))
        self.folder.save(site)
        current = [self.folder.site.member(who.who) for who in new]
        return self._issue_all(current, days, request)

    def renew(self, members: Iterable[Identity], days: float = DAYS) -> Written:
        """New keys and certificates under the same names; rules stay as they are."""
        return self._issue_all(members, days)

    def revoke(self, who: Identity) -> Written:
        """Rules that no longer know a certificate; a renewed one will be of the next generation.

        Raises:
            SiteError: it is the certificate by which the keeper asks routers what they run.
        """
        if who.who == HEALTH.who:
            raise SiteError(f"{HEALTH.who} never leaves this folder: renew it instead")
        self.folder.save(self.folder.site.with_generation(who.of_generation(who.generation + 1)))
        self.folder.bundle(who).unlink(missing_ok=True)
        return Written(rules=self.write_rules())

    def expiring(self, within_days: float, now: datetime | None = None) -> list[Identity]:
        """Members whose certificate ends within so many days; who was revoked must be named."""
        now, newest = now or datetime.now(UTC), self.folder.newest()
        return [
            who
            for who in self.folder.site.members()
            if (record := newest.get(who.common_name)) and record.days_left(now) <= within_days
        ]

    def write_rules(self) -> list[str]:
        """Writes the routers' configurations; returns the names of those that changed."""
        self._configurations.clear()
        changed = []
        for name in self.folder.site.routers:
            path, text = self.folder.rules(name), text_of(self._of_router(name))
            if not path.exists() or path.read_text() != text:
                write_file(path, text)
                self._put_into_bundle(self.folder.site.member(f"router/{name}"), text)
                changed.append(name)
        return changed

    def without_certificate(self) -> list[Identity]:
        """Members that were revoked, or written into `site.toml` by hand."""
        newest = self.folder.newest()
        return [who for who in self.folder.site.members() if who.common_name not in newest]

    def _next_generation(self, who: Identity) -> int:
        """One more than any that this name has had: also one that was taken out of `site.toml`."""
        had = [Identity.parse(name) for name in self.folder.newest()]
        issued = [one.generation for one in had if one.who == who.who]
        revoked = self.folder.site.generations.get(who.who, 1)
        return max([revoked, *(generation + 1 for generation in issued)])

    def _put_into_bundle(self, router: Identity, rules: str) -> None:
        """A router's bundle that is not under a password gets the new rules as well."""
        path = self.folder.bundle(router)
        content = path.read_bytes() if path.exists() else b""
        if content and not is_sealed(content):
            files = unpacked(content, str(path)) | {CONFIGURATION: rules.encode()}
            manifest = manifest_of(files[MANIFEST], str(path))
            files[MANIFEST] = _json(manifest.model_copy(update={"issued": datetime.now(UTC)}))
            write_file(path, packed(files))

    def _issue_all(
        self, members: Iterable[Identity], days: float, request: bytes | None = None
    ) -> Written:
        rules = self.write_rules()
        return Written([self._issue(who, days, request) for who in members], rules)

    def _issue(self, who: Identity, days: float, request: bytes | None) -> Bundled:
        hosts = {router.name: router.host for router in self.folder.site.addresses()}
        host = hosts[who.name] if who.role == "router" else None
        issued = self._authority.issue(who, days, host, request)
        self.folder.note(who, issued)
        content = packed(self._files(who, issued))
        path = self.folder.bundle(who)
        write_file(path, self._sealer.seal(content) if self._sealer else content)
        return Bundled(who, path, issued.not_after)

    def _files(self, who: Identity, issued: Issued) -> Mapping[str, bytes]:
        key = {} if issued.key_pem is None else {KEY: issued.key_pem}
        return {
            MANIFEST: _json(self._manifest(who, issued)),
            CA: self._authority.pem,
            CERTIFICATE: issued.pem,
            **key,
            CONFIGURATION: text_of(self._configuration(who)).encode(),
        }

    def _manifest(self, who: Identity, issued: Issued) -> Manifest:
        return Manifest(
            site=self.folder.site.site,
            role=who.role,
            name=who.name,
            generation=who.generation,
            issued=datetime.now(UTC),
            not_after=issued.not_after,
            routers=self.folder.site.addresses(),
            ca_sha256=self._authority.fingerprint,
            certificate_sha256=issued.der_sha256,
            fleetpose=release(),
        )

    def _configuration(self, who: Identity) -> dict[str, Any]:
        site = self.folder.site
        if who.role == "router":
            return self._of_router(who.name)
        return client_configuration(site.site, who, site.addresses())

    def _of_router(self, name: str) -> dict[str, Any]:
        if name not in self._configurations:
            self._configurations = router_configurations(self.folder.site)
        return self._configurations[name]


def _json(manifest: Manifest) -> bytes:
    return manifest.model_dump_json(indent=1).encode()


def router_configurations(site: Site) -> dict[str, dict[str, Any]]:
    """The configuration of each router: a function of what `site.toml` says, and nothing else."""
    access, rates = access_control(site.keys, site.members()), limits(site.keys, site.rates)
    addresses = site.addresses()
    return {
        here.name: router_configuration(
            site.site, site.member(f"router/{here.name}"), here, addresses[:place], access, rates
        )
        for place, here in enumerate(addresses)
    }


def hash_of(site: Site) -> str:
    """Of the rules that follow from `site.toml` now."""
    return rules_hash(access_control(site.keys, site.members()), limits(site.keys, site.rates))


def make_site(
    path: Path, site: Site, sealer: Sealer | None = None
) -> tuple[Keeper, Written, float]:
    """A new site's folder with its first bundles, and the seconds that took."""
    began = time.monotonic()
    if not site.routers:
        raise SiteError("a site needs a router: --router a=HOST")
    site.addresses()
    keeper = Keeper(SiteFolder.make(path, site, Authority.make(site.site)), sealer)
    written = keeper.start()
    return keeper, written, time.monotonic() - began
