"""What a bundle says of itself; on a machine it lies beside the certificate."""

from datetime import datetime
from typing import Annotated

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from fleetpose.deploy.errors import BundleError
from fleetpose.deploy.identity import Identity
from fleetpose.protocol.keys import NAME_PATTERN
from fleetpose.protocol.text import one_line

MANIFEST, CA, CERTIFICATE, KEY = "manifest.json", "ca.pem", "cert.pem", "key.pem"
CONFIGURATION = "zenoh.json5"
BUNDLE_VERSION = 1
DEFAULT_PORT = 7447

_Name = Annotated[str, Field(pattern=NAME_PATTERN)]
_Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class _Said(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RouterAddress(_Said):
    """Where a router of the site is reached."""

    name: _Name
    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9.:-]{1,253}$")]
    port: Annotated[int, Field(ge=1, le=65535)] = DEFAULT_PORT

    @property
    def endpoint(self) -> str:
        """As zenoh writes it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"tls/{host}:{self.port}"


class Manifest(_Said):
    """Whose bundle it is, until when it holds, and which files belong to it.

    Attributes:
        certificate_sha256: of the certificate's DER, so that what is said here is said of it.
        issued: when it was made, by the clock of the site's keeper.
    """

    bundle: int = BUNDLE_VERSION
    site: _Name
    role: str
    name: _Name
    generation: Annotated[int, Field(ge=1)] = 1
    issued: AwareDatetime
    not_after: AwareDatetime
    routers: tuple[RouterAddress, ...]
    ca_sha256: _Digest
    certificate_sha256: _Digest
    fleetpose: str

    @property
    def identity(self) -> Identity:
        return Identity(self.role, self.name, self.generation)

    def days_left(self, now: datetime) -> float:
        return (self.not_after - now).total_seconds() / 86400


def manifest_of(text: bytes | str, where: str) -> Manifest:
    """Reads a manifest.

    Raises:
        BundleError: it is not one, or of a version that this program does not know.
    """
    try:
        manifest = Manifest.model_validate_json(text)
    except ValidationError as error:
        said = error.errors()[0]
        place = ".".join(str(part) for part in said["loc"]) or "it"
        raise BundleError(
            f"{where}: the manifest is damaged ({place}: {one_line(said['msg'])}): "
            "fetch the bundle again"
        ) from error
    if manifest.bundle != BUNDLE_VERSION:
        raise BundleError(
            f"{where}: bundles of version {manifest.bundle} are not known here: "
            "install the fleetpose that made it"
        )
    _ = manifest.identity  # a role that does not exist is refused here
    return manifest
