"""Who a process is, as the configuration that goes with its certificate says:
`metadata: {fleetpose: {site, role, name}}`, which zenoh ignores and `pose-deploy` writes.

The router's rules go by the certificate. A process under another name would be denied everything in
silence, so another name is refused at the start.
"""

from dataclasses import dataclass
from pathlib import Path

from fleetpose.protocol.errors import EndpointError, FleetPoseError
from fleetpose.protocol.keys import checked_name
from fleetpose.protocol.session import configuration
from fleetpose.protocol.session.configuration import Configuration

ROLES = ("robot", "server", "operator", "observer", "recorder", "router", "health")


@dataclass(frozen=True)
class Identity:
    """Who a configuration belongs to."""

    site: str
    role: str
    name: str

    def __str__(self) -> str:
        name = "" if self.name == self.role else f" '{self.name}'"
        return f"{self.role}{name} of site '{self.site}'"

    def settle(self, what: str, given: str | None, own: str, file: Path) -> str:
        """The value of a setting that the identity knows.

        Args:
            what: the option, e.g. `--name`.
            given: what a user gave for it, None if nothing.
            own: what the identity says.
            file: the configuration.

        Raises:
            EndpointError: the two differ.
        """
        if given is not None and given != own:
            raise EndpointError(
                f"{what} {given}: {file} is the configuration of {self}; leave {what} out, or "
                f"take the configuration that goes with it"
            )
        return own


def identity_in(file: Path, roles: tuple[str, ...]) -> Identity | None:
    """Who a configuration file belongs to, None where it does not say.

    Args:
        file: a zenoh configuration (JSON5).
        roles: what the process can be.

    Raises:
        EndpointError: the file cannot be used, or belongs to another kind of process.
    """
    identity = identity_of(configuration.read(file), file)
    if identity is not None and identity.role not in roles:
        raise EndpointError(
            f"{file} is the configuration of {identity}: take that of "
            f"{' or '.join(_an(role) for role in roles)}"
        )
    return identity


def identity_of(config: Configuration, file: Path) -> Identity | None:
    """Who a configuration belongs to, None where it does not say.

    Raises:
        EndpointError: what it says is no identity.
    """
    told = (config.get("metadata") or {}).get("fleetpose")
    if told is None:
        return None
    try:
        site, role, name = (checked_name(told[part]) for part in ("site", "role", "name"))
    except (KeyError, TypeError, FleetPoseError) as error:
        raise EndpointError(
            f"metadata.fleetpose of {file} must hold site, role and name: {error}"
        ) from error
    if role not in ROLES:
        raise EndpointError(f"{file}: there is no role '{role}'; roles are {', '.join(ROLES)}")
    return Identity(site, role, name)


def _an(role: str) -> str:
    return f"{'an' if role[0] in 'aeiou' else 'a'} {role}"
