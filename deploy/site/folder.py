"""The site's folder: `site.toml`, the one file that is edited, and what is made from it.

site.toml      names, routers, generations, rates
ca/            the certificate authority; whoever has ca.key can make anybody
issued.jsonl   every certificate that was issued, one a line
rules/         the routers' configurations
bundles/       what is installed on the machines
"""

import json
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from fleetpose.deploy.errors import SiteError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import DEFAULT_PORT, RouterAddress
from fleetpose.deploy.private_files import make_folder, readable_by_others, write_file
from fleetpose.deploy.site.certificates import Authority, Issued
from fleetpose.deploy.site.limits import Rates
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import NAME_PATTERN, Keys

SITE, ISSUED, CA_CERTIFICATE, CA_KEY = "site.toml", "issued.jsonl", "ca/ca.pem", "ca/ca.key"
NAMED = ("robots", "operators", "observers", "recorders")
HEALTH = Identity("health", "desk")
"""By whose certificate the site's keeper asks routers what they run."""

_Name = Annotated[str, Field(pattern=NAME_PATTERN)]


class Site(BaseModel):
    """What `site.toml` says.

    Attributes:
        routers: addresses `HOST[:PORT]` by name, in the order in which clients ask them.
        generations: of those whose certificates were revoked; all others are in their first. Who
            was removed stays here, so that the same name never gets an old certificate's rules.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    site: _Name
    robots: tuple[_Name, ...] = ()
    operators: tuple[_Name, ...] = ()
    observers: tuple[_Name, ...] = ()
    recorders: tuple[_Name, ...] = ()
    routers: dict[_Name, str]
    generations: dict[str, Annotated[int, Field(ge=1)]] = {}
    rates: Rates = Field(default_factory=lambda: Rates.model_validate({}))

    @property
    def keys(self) -> Keys:
        return Keys(self.site)

    def addresses(self) -> tuple[RouterAddress, ...]:
        """Of the routers.

        Raises:
            SiteError: one is not HOST or HOST:PORT.
        """
        return tuple(router_address(name, text) for name, text in self.routers.items())

    def members(self) -> list[Identity]:
        """Everybody who has a certificate, in the generation that holds."""
        named = (
            *(("robot", name) for name in self.robots),
            *(("operator", name) for name in self.operators),
            *(("observer", name) for name in self.observers),
            *(("recorder", name) for name in self.recorders),
            *(("router", name) for name in self.routers),
        )
        everybody = [Identity("server", "server"), HEALTH]
        everybody += [Identity(role, name) for role, name in named]
        return [who.of_generation(self.generations.get(who.who, 1)) for who in everybody]

    def member(self, who: str) -> Identity:
        """Of this name, in the generation that holds.

        Raises:
            SiteError: the site has nobody of this name.
        """
        asked = Identity.parse(who).who
        for one in self.members():
            if one.who == asked:
                return one
        raise SiteError(f"site '{self.site}' has no {asked}: 'pose-deploy show' lists who there is")

    def with_names(self, role: str, names: Iterable[str]) -> Self:
        """With more robots, operators, observers or recorders; names that it has already stay."""
        plural = f"{role}s"
        there = getattr(self, plural)
        return self.model_copy(update={plural: tuple(dict.fromkeys((*there, *names)))})

    def with_generation(self, who: Identity) -> Self:
        """With somebody's certificates counting from this generation on."""
        others = {name: n for name, n in self.generations.items() if name != who.who}
        changed = {who.who: who.generation} if who.generation > 1 else {}
        return self.model_copy(update={"generations": others | changed})


def router_address(name: str, text: str) -> RouterAddress:
    """Reads `HOST`, `HOST:PORT` or `[IPV6]:PORT`.

    Raises:
        SiteError: it is not of that form.
    """
    host, colon, port = text.rpartition(":")
    if not colon or (":" in host and not host.startswith("[")):
        host, port = text, str(DEFAULT_PORT)
    try:
        return RouterAddress(name=name, host=host.strip("[]"), port=int(port))
    except ValueError as error:
        raise SiteError(
            f"router {name}: '{text}' is no address: write HOST or HOST:PORT, e.g. "
            f"{name}=router-{name}.internal:{DEFAULT_PORT}"
        ) from error


class SiteFolder:
    """The files of a site.

    Raises:
        SiteError: there is none, others may read it, or what it says cannot be.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not (path / SITE).is_file():
            raise SiteError(f"{path} is no site's folder: make one with 'pose-deploy init {path}'")
        if readable_by_others(path):
            raise SiteError(
                f"{path} can be read by others, and holds the CA's key: chmod 700 {path}"
            )
        self.site = _read_site(path / SITE)

    @classmethod
    def make(cls, path: Path, site: Site, authority: Authority) -> Self:
        """A new one.

        Raises:
            SiteError: the folder is not empty.
        """
        if path.exists() and any(path.iterdir()):
            raise SiteError(f"{path} is not empty: name a folder that can be made")
        make_folder(path)
        for name in ("ca", "rules", "bundles"):
            make_folder(path / name)
        write_file(path / CA_CERTIFICATE, authority.pem)
        write_file(path / CA_KEY, authority.key_pem)
        write_file(path / SITE, _text_of(site))
        return cls(path)

    def save(self, site: Site) -> None:
        """Writes `site.toml` anew."""
        write_file(self.path / SITE, _text_of(site))
        self.site = site

    def authority(self) -> Authority:
        """Raises SiteError where the CA is missing or damaged."""
        try:
            files = [(self.path / name).read_bytes() for name in (CA_CERTIFICATE, CA_KEY)]
        except OSError as error:
            raise SiteError(
                f"{error.filename}: {error.strerror}: restore the site's ca/"
            ) from error
        return Authority.load(self.site.site, *files)

    def bundle(self, who: Identity) -> Path:
        return self.path / "bundles" / f"{who.folder}.fleetpose"

    def rules(self, router: str) -> Path:
        return self.path / "rules" / f"router-{router}.json5"

    def note(self, who: Identity, issued: Issued) -> None:
        """Appends to the list of what was issued."""
        line = {
            "cn": who.common_name,
            "serial": issued.serial,
            "sha256": issued.der_sha256,
            "not_before": issued.not_before.isoformat(),
            "not_after": issued.not_after.isoformat(),
        }
        path = self.path / ISSUED
        path.touch(mode=0o600)
        with path.open("a") as file:
            file.write(json.dumps(line) + "\n")

    def newest(self) -> dict[str, "Record"]:
        """What was issued last to each common name."""
        return {record.cn: record for record in self._issued()}

    def _issued(self) -> Iterator["Record"]:
        path = self.path / ISSUED
        for number, line in enumerate(path.read_text().splitlines() if path.exists() else (), 1):
            try:
                yield Record.model_validate_json(line)
            except ValidationError as error:
                raise SiteError(
                    f"{path}, line {number}, is damaged: restore or remove it"
                ) from error


class Record(BaseModel):
    """A line of `issued.jsonl`."""

    cn: str
    serial: str
    sha256: str
    not_before: AwareDatetime
    not_after: AwareDatetime

    def days_left(self, now: datetime) -> float:
        return (self.not_after - now).total_seconds() / 86400


def _read_site(path: Path) -> Site:
    try:
        site = Site.model_validate(tomllib.loads(path.read_text()))
        site.addresses()
    except tomllib.TOMLDecodeError as error:
        raise SiteError(f"{path}: {error}") from error
    except ValidationError as error:
        said = error.errors()[0]
        place = ".".join(str(part) for part in said["loc"])
        raise SiteError(f"{path}: {place}: {said['msg']}") from error
    try:
        for who in site.generations:
            Identity.parse(who)
    except FleetPoseError as error:
        raise SiteError(f"{path}: generations: {error}") from error
    return site


def _text_of(site: Site) -> str:
    """As TOML, with what each part means."""
    rates = {
        name: (getattr(site.rates, name), field.description)
        for name, field in Rates.model_fields.items()
    }
    lines = [
        "# Who belongs to this site. After a change: pose-deploy rules FOLDER",
        f"site = {json.dumps(site.site)}",
        *(_names(role, getattr(site, role)) for role in NAMED),
        "",
        "[routers] # HOST:PORT of each, in the order in which they are asked",
        *_table(site.routers),
        "",
        "[generations] # of certificates; who is not named is in the first. Remove nothing here",
        *_table(site.generations),
        "",
        "[rates] # what routers let through of each robot or operator",
        *(f"{name} = {value} # {meaning}" for name, (value, meaning) in rates.items()),
    ]
    return "\n".join(lines) + "\n"


def _names(role: str, names: Iterable[str]) -> str:
    return f"{role} = {json.dumps(list(names))}"


def _table(values: Mapping[str, Any]) -> list[str]:
    return [f"{json.dumps(name)} = {json.dumps(value)}" for name, value in values.items()]
