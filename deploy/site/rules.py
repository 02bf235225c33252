"""A router's access control from the site's one policy: what zenoh has to be told so that exactly
what `permissions` allows can be said, and nothing is denied while all goes well.

Directions are the router's: `ingress` is what somebody says to it, `egress` what it tells them.
A latched key K costs more than K: its publisher shows a token, answers from a cache and sends
heartbeats under `K/@adv/pub/...`, and the cache's answers come under K itself.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import zenoh

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.site.permissions import ADMIN, Permissions, everybody, permissions
from fleetpose.protocol.keys import Keys

PUT, DELETE, QUERY, REPLY = "put", "delete", "query", "reply"
SUBSCRIBER, QUERYABLE = "declare_subscriber", "declare_queryable"
TOKEN, LOOK, WATCH = "liveliness_token", "liveliness_query", "declare_liveliness_subscriber"
MESSAGES = (PUT, DELETE, QUERY, REPLY, SUBSCRIBER, QUERYABLE, TOKEN, LOOK, WATCH)
INGRESS, EGRESS = "ingress", "egress"

Allowance = tuple[str, str, tuple[str, ...]]
"""A direction, a kind of message, and the key expressions of it that may pass."""


def access_control(keys: Keys, members: Iterable[Identity]) -> dict[str, Any]:
    """zenoh's `access_control` for a site: what is not named here is denied.

    Args:
        keys: of the site.
        members: everybody with a certificate, routers included, each in the generation that holds.
    """
    collected = _Collected()
    readers = _readers(keys)
    for who in members:
        if who.role == "router":
            collected.give(who, _between_routers(keys))
        else:
            allowed = permissions(keys, who.role, who.name)
            collected.give(who, allowances(allowed, readers))
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": collected.rules,
        "subjects": collected.subjects,
        "policies": collected.policies,
    }


@dataclass(frozen=True)
class Readers:
    """Key expressions that anybody at the site subscribes to, as they write them."""

    follows: tuple[str, ...]
    hears: tuple[str, ...]


def _readers(keys: Keys) -> Readers:
    roles = everybody(keys)
    return Readers(
        _without_doubles(key for role in roles for key in role.follows),
        _without_doubles(key for role in roles for key in role.hears),
    )


def allowances(may: Permissions, readers: Readers) -> list[Allowance]:
    """What a router has to let through for these permissions.

    Args:
        may: of one member.
        readers: of the site: a publisher stays silent unless it learns who listens, and it learns
            it in the words of who listens.
    """
    return [allowance for allowance in (*_says(may, readers), *_hears(may)) if allowance[2]]


def _says(may: Permissions, readers: Readers) -> Iterable[Allowance]:
    followed = _meeting(may.latches, readers.follows)
    heard = _meeting((*may.puts, *may.latches), (*readers.hears, *followed))
    yield INGRESS, PUT, (*may.latches, *may.puts, *_beside(may.latches))
    yield EGRESS, SUBSCRIBER, (*heard, *_beside(followed))
    yield INGRESS, QUERYABLE, (*may.answers, *_beside(may.latches))
    yield INGRESS, REPLY, (*may.answers, *may.latches)
    yield EGRESS, QUERY, (*may.answers, *_beside(followed, "@adv/**"))
    yield INGRESS, TOKEN, (*may.shows, *_beside(may.latches))


def _hears(may: Permissions) -> Iterable[Allowance]:
    heard = (*may.follows, *may.hears, *_beside(may.follows))
    yield INGRESS, SUBSCRIBER, heard
    yield EGRESS, PUT, heard
    yield INGRESS, QUERY, (*may.asks, *_beside(may.follows, "@adv/**"))
    yield EGRESS, REPLY, (*may.asks, *may.follows)
    yield INGRESS, LOOK, may.sees
    yield INGRESS, WATCH, (*may.sees, *_beside(may.follows))
    yield EGRESS, TOKEN, (*may.sees, *_beside(may.follows))


def _between_routers(keys: Keys) -> list[Allowance]:
    """Routers carry everything of the site; each has checked those who are connected to it."""
    everything = (f"{keys.root}/**", f"{keys.root}/**/@adv/**", ADMIN)
    return [(flow, message, everything) for flow in (INGRESS, EGRESS) for message in MESSAGES]


def _beside(keys: Sequence[str], what: str = "@adv/pub/**") -> tuple[str, ...]:
    return tuple(f"{key}/{what}" for key in keys)


def _meeting(written: Sequence[str], read: Sequence[str]) -> tuple[str, ...]:
    """What is written, and the readers' expressions that meet it; none that another includes."""
    exprs = [zenoh.KeyExpr(key) for key in _without_doubles((*read, *written))]
    writes = [zenoh.KeyExpr(key) for key in written]
    met = [expr for expr in exprs if any(expr.intersects(one) for one in writes)]
    return tuple(
        str(expr) for expr in met if not any(other.includes(expr) for other in met if other != expr)
    )


def _without_doubles(keys: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(keys))


@dataclass
class _Collected:
    """Rules with their subjects; what several may do is written once."""

    rules: list[dict[str, Any]] = field(default_factory=list)
    subjects: list[dict[str, Any]] = field(default_factory=list)
    policies: list[dict[str, Any]] = field(default_factory=list)
    _known: dict[Allowance, str] = field(default_factory=dict)

    def give(self, who: Identity, allowed: Iterable[Allowance]) -> None:
        ids = [self._rule(who, allowance) for allowance in allowed]
        subject = {"id": who.folder, "cert_common_names": [who.common_name]}
        self.subjects.append(subject)
        self.policies.append({"id": who.folder, "rules": ids, "subjects": [who.folder]})

    def _rule(self, who: Identity, allowance: Allowance) -> str:
        if allowance not in self._known:
            flow, message, keys = allowance
            name = f"{who.role}-{flow}-{message}-{len(self.rules)}".replace("_", "-")
            self._known[allowance] = name
            self.rules.append(
                {
                    "id": name,
                    "permission": "allow",
                    "flows": [flow],
                    "messages": [message],
                    "key_exprs": list(keys),
                }
            )
        return self._known[allowance]


def includes(expression: str, key: str) -> bool:
    """Whether all that a key expression stands for is in another."""
    return zenoh.KeyExpr(expression).includes(zenoh.KeyExpr(key))
