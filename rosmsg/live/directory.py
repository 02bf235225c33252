"""The topics of a domain, by the tokens that their publishers show."""

from collections import Counter
from dataclasses import dataclass, field

from fleetpose.protocol.errors import CodecError
from fleetpose.rosmsg.dialects.rmw_zenoh import Endpoint, endpoint_of

MOST = 2000  # publishers: a large robot has some hundreds
LONGEST_TOKEN = 1000  # characters


@dataclass
class Directory:
    """Publishers that are there.

    Attributes:
        most: beyond, they are refused.
    """

    most: int = MOST
    _publishers: dict[str, Endpoint] = field(default_factory=dict)

    def note(self, token: str, alive: bool) -> None:
        """A token came or went.

        Raises:
            CodecError: it cannot be kept: it is too long, or too many are there.
        """
        if not alive:
            self._publishers.pop(token, None)
            return
        if len(token) > LONGEST_TOKEN:
            raise CodecError(f"a token of {len(token)} characters")
        endpoint = endpoint_of(token)
        if endpoint is None or endpoint.kind != "publisher":
            return
        if len(self._publishers) >= self.most and token not in self._publishers:
            raise CodecError(f"more than {self.most} publishers")
        self._publishers[token] = endpoint

    def endpoints(self) -> dict[str, Endpoint]:
        """One of each topic's, in the order of their names."""
        found: dict[str, Endpoint] = {}
        for endpoint in self._publishers.values():
            found.setdefault(endpoint.topic, endpoint)
        return dict(sorted(found.items()))

    def publishers(self) -> Counter[str]:
        """How many each topic has."""
        return Counter(endpoint.topic for endpoint in self._publishers.values())
