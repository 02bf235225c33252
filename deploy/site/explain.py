"""Why a router lets somebody say or hear something, or why not: read from its rules as they are."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import zenoh

from fleetpose.deploy.errors import SiteError
from fleetpose.deploy.identity import Identity
from fleetpose.deploy.site.rules import (
    DELETE,
    EGRESS,
    INGRESS,
    LOOK,
    PUT,
    QUERY,
    QUERYABLE,
    SUBSCRIBER,
    TOKEN,
    includes,
)

VERBS = {
    "put": (INGRESS, PUT),
    "delete": (INGRESS, DELETE),
    "subscribe": (INGRESS, SUBSCRIBER),
    "hear": (EGRESS, PUT),
    "ask": (INGRESS, QUERY),
    "answer": (INGRESS, QUERYABLE),
    "show": (INGRESS, TOKEN),
    "see": (INGRESS, LOOK),
}
"""What somebody does at a router, and the messages that it takes; `show` and `see` are tokens."""


@dataclass(frozen=True)
class Explained:
    """Whether it is allowed, and why, in a sentence."""

    allowed: bool
    text: str


def explain(access: dict[str, Any], who: Identity, verb: str, key: str) -> Explained:
    """What the rules say of one message.

    Args:
        access: zenoh's `access_control`.
        who: in the generation of the certificate that is used.
        verb: one of `VERBS`.
        key: a key, or a key expression.

    Raises:
        SiteError: there is no such verb, or it is no key.
    """
    if verb not in VERBS:
        raise SiteError(f"'{verb}' is nothing that can be done: write {', '.join(VERBS)}")
    flow, message = VERBS[verb]
    mine = []
    for rule, expression in allowing(access, who.common_name, flow, message):
        if _includes(expression, key):
            said = f"{who.common_name} may {verb} {key}: rule {rule} allows {expression}"
            return Explained(True, said)
        mine.append(expression)
    if not mine:
        return Explained(False, f"{who.common_name} may {verb} nothing at all")
    allowed = ", ".join(one for one in mine if "/@adv/" not in one)
    return Explained(False, f"{who.common_name} may not {verb} {key}, only {allowed}")


def allowing(
    access: dict[str, Any], common_name: str, flow: str, message: str
) -> Iterator[tuple[str, str]]:
    """Name and key expression of the rules that let a certificate through."""
    subjects = {s["id"] for s in access["subjects"] if common_name in s["cert_common_names"]}
    named = {
        rule
        for policy in access["policies"]
        if subjects.intersection(policy["subjects"])
        for rule in policy["rules"]
    }
    for rule in access["rules"]:
        if rule["id"] in named and flow in rule["flows"] and message in rule["messages"]:
            yield from ((rule["id"], expression) for expression in rule["key_exprs"])


def _includes(expression: str, key: str) -> bool:
    try:
        return includes(expression, key)
    except zenoh.ZError as error:
        raise SiteError(f"'{key}' is no key: write chunks with '/' between") from error
