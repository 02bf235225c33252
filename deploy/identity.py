"""Who somebody is at a site: what certificates, rules, bundles and folders are named by."""

import re
from dataclasses import dataclass, replace
from typing import Self

from fleetpose.deploy.errors import SiteError
from fleetpose.protocol.keys import checked_name

ROLES = ("robot", "operator", "observer", "recorder", "server", "router", "health")
ALONE = ("server",)  # roles of which a site has one, without a name of its own
_TEXT = re.compile(r"([a-z]+)(?:/([a-z0-9_-]+))?(?:#(\d+))?")


@dataclass(frozen=True, order=True)
class Identity:
    """A role, a name and a generation; `robot/r1`, `server`, and `robot/r1#2` once revoked.

    Rules name the newest generation only, so that a certificate of an older one passes nothing.
    """

    role: str
    name: str
    generation: int = 1

    def __post_init__(self) -> None:
        checked_name(self.name)
        if self.role not in ROLES or (self.role in ALONE and self.name != self.role):
            raise SiteError(f"'{self.role}/{self.name}' is nobody: write {' or '.join(ROLES)}/NAME")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Reads `robot/r1`, `server` or `robot/r1#2`.

        Raises:
            SiteError: it is not of that form.
        """
        match = _TEXT.fullmatch(text)
        if match is None or not (match[2] or match[1] in ALONE):
            raise SiteError(f"'{text}' is nobody: write e.g. robot/r1, operator/anna or server")
        return cls(match[1], match[2] or match[1], int(match[3] or 1))

    @property
    def who(self) -> str:
        """Without the generation: `robot/r1`, `server`."""
        return self.role if self.role in ALONE else f"{self.role}/{self.name}"

    @property
    def common_name(self) -> str:
        """In the certificate, and in the rules."""
        return self.who if self.generation == 1 else f"{self.who}#{self.generation}"

    @property
    def folder(self) -> str:
        """Name of its folder on its machine, and of its bundle: `robot-r1`, `server`."""
        return self.who.replace("/", "-")

    def of_generation(self, generation: int) -> Self:
        return replace(self, generation=generation)
