"""Who should not be let in at all: certificates that have expired, of other sites, or none."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import zenoh

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.manifest import CA, CONFIGURATION
from fleetpose.deploy.site.certificates import Authority
from fleetpose.evaluation.system.field.attackers.attempts import EVIL
from fleetpose.evaluation.system.field.site import Change, Field, opened
from fleetpose.pose_server.routing.denials import STRANGER

R1 = Identity("robot", "r1")


@dataclass(frozen=True)
class Stranger:
    """One who tries to get in.

    Attributes:
        cause: that the router should tell.
        enters: a session can be opened, in which nothing passes.
    """

    name: str
    cause: str
    open: Callable[[], zenoh.Session]
    enters: bool = False


def strangers(field: Field) -> Iterator[Stranger]:
    """Each with a certificate of its own, against the site's router."""
    authority = field.keeper.folder.authority()
    tomorrow = datetime.now(UTC) + timedelta(days=1)
    other, same_name = Authority.make("other"), Authority.make(field.site.site)

    def forged(name: str, issued: Any, ca: bytes | None = None) -> Callable[[], zenoh.Session]:
        folder = field.with_certificate(name, issued)
        if ca is not None:
            (folder / CA).write_bytes(ca)
        return lambda: _opened(folder)

    def changed(change: Change) -> Callable[[], zenoh.Session]:
        return lambda: field.open("robot/r1", change)

    def nothing(told: dict[str, Any]) -> None:
        tls = told["transport"]["link"]["tls"]
        for one in ("connect_private_key", "connect_certificate"):
            del tls[one]
        tls["enable_mtls"] = False

    def plain(told: dict[str, Any]) -> None:
        told["transport"]["link"]["protocols"] = ["tcp"]
        told["connect"]["endpoints"] = [f"tcp/127.0.0.1:{field.router().port}"]

    expired = authority.issue(R1, days=-0.01)
    yield Stranger("expired", "expired", forged("expired", expired))
    early = authority.issue(R1, days=9, now=tomorrow)
    yield Stranger("of tomorrow", "not valid yet", forged("early", early))
    yield Stranger("other site", "of another site", forged("other", other.issue(R1, days=9)))
    of_same = forged("same", same_name.issue(R1, days=9))
    said = "of another authority with this site's name"
    yield Stranger("other site of this name", said, of_same)
    yield Stranger("no certificate", "without a certificate", changed(nothing))
    yield Stranger("no TLS", "without TLS", changed(plain))
    unknown = authority.issue(Identity("robot", "r99"), days=9)
    yield Stranger("unknown to the rules", STRANGER, forged("unknown", unknown), enters=True)
    old = authority.issue(Identity("robot", "r1", 9), days=9)
    yield Stranger("of a generation unknown", STRANGER, forged("generation", old), enters=True)


def _opened(folder: Path) -> zenoh.Session:
    return opened(folder / CONFIGURATION)


def entered(field: Field, stranger: Stranger, mark: bytes) -> bool:
    """Tries it; whether a session was opened that should not be. One that may be says all that a
    robot could, with a mark by which it would be known.
    """
    keys = field.keys
    with suppress(zenoh.ZError), stranger.open() as session:
        for key in (keys.cloud("r1"), keys.image("r1"), keys.pose("r1"), keys.updates("anna")):
            session.put(key, EVIL + mark)
        return not stranger.enters
    return False
