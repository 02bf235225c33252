"""What members of a site try that they may not: each attempt, and how it would show that it passed.

An attempt is made by a raw session with somebody's own certificate, beside the fleet that runs.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

import zenoh

from fleetpose.evaluation.system.field.site import Field
from fleetpose.pose_server.routing.denials import kind_of
from fleetpose.protocol.keys import Keys

EVIL = b"EVIL"
ANSWER_S = 2.0


@dataclass
class Attempt:
    """One of them.

    Attributes:
        who: whose certificate is used, as it is named in it.
        verb: of `denials.WORDS`.
        key: what is said, heard, asked or shown.
        reached: what came of it that should not.
    """

    who: str
    verb: str
    key: str
    reached: list[str] = field(default_factory=list)

    @property
    def kind(self) -> str:
        """The key as routers tell it."""
        return kind_of(self.key)

    def __str__(self) -> str:
        return f"{self.who} {self.verb} {self.kind}"


def attempts(keys: Keys) -> list[Attempt]:
    """All of them, for a site with robots r1 and r2, operators anna and ben, and observer wall."""
    cache = f"{keys.camera('r1')}/@adv/pub/{'a' * 32}/7/_"
    said_by_robot = (
        *(keys.cloud("r1"), keys.camera("r1"), keys.image("r1"), keys.odometry("r1")),
        *(keys.pose("r1"), keys.pose("r2"), keys.state, keys.status, keys.heard("r1")),
        *(keys.receipts("anna"), keys.alignment("r1", "r2"), keys.correspondences("r1", "r2")),
        *(keys.updates("anna"), keys.selection("anna"), keys.updates("r2"), keys.denials("a")),
        *(keys.cloud("*"), f"{keys.root}/robot/**", "**", keys.check("robot", "r1", "x")),
        *(Keys("other").cloud("r2"), cache, "@/*/router/config/access_control/enabled"),
    )
    deleted = (keys.cloud("r1"), keys.camera("r1"), keys.pose("r1"), keys.pose("r2"))
    shown = (keys.robot_alive("r1", "a" * 12), keys.robot_alive("r9", "b" * 12))
    shown += (keys.server_alive("c" * 12), cache)
    answered = (keys.view("r1"), keys.relative, keys.why, keys.server_view, cache)
    heard = (keys.image("r1"), keys.cloud("r1"), keys.heard("r1"), keys.updates("anna"))
    heard += (f"{keys.root}/robot/**", f"{keys.root}/operator/**", f"{keys.root}/**", "**")
    asked = (keys.view("r1"), "@/*/router", f"{keys.camera('r1')}/@adv/**")
    by_who_looks = (keys.updates("anna"), keys.updates("wall"), keys.state, keys.pose("r1"))
    by_operator = (keys.updates("anna"), keys.selection("anna"), keys.receipts("anna"), keys.state)
    told: list[tuple[str, str, Iterable[str]]] = [
        ("robot/r2", "put", said_by_robot),
        ("robot/r2", "delete", deleted),
        ("robot/r2", "show", shown),
        ("robot/r2", "answer", answered),
        ("robot/r2", "listen", heard),
        ("robot/r2", "ask", asked),
        ("observer/wall", "put", by_who_looks),
        ("operator/ben", "put", by_operator),
        ("operator/ben", "listen", (keys.updates("anna"), keys.receipts("anna"))),
        ("operator/ben", "ask", (f"{keys.updates('anna')}/@adv/**",)),
    ]
    return [Attempt(who, verb, key) for who, verb, all_keys in told for key in all_keys]


OF_SERVER = ("cloud", "odometry", "updates", "selection")


class Victims:
    """Who may hear what the attempts would say, by sessions with their own certificates.

    Args:
        site: where a router runs.
        open_: opens a session with somebody's certificate.
    """

    def __init__(self, site: Field, open_: Callable[[str], zenoh.Session]) -> None:
        keys = site.keys
        self.server, self.wall = open_("server"), open_("observer/wall")
        self.r1, anna = open_("robot/r1"), open_("operator/anna")
        self._heard: list[tuple[str, bytes, zenoh.SampleKind]] = []
        self._alive: list[str] = []
        everything = {
            self.server: [getattr(keys, name)("*") for name in OF_SERVER],
            self.wall: [keys.poses, keys.state, keys.status, keys.camera("*"), keys.image("*")],
            self.r1: [keys.heard("r1"), keys.check("robot", "r1", "*")],
            anna: [keys.receipts("anna"), keys.correspondences("*", "*")],
        }
        for session, expressions in everything.items():
            for expression in expressions:
                session.declare_subscriber(expression, self._note)
        for expression in (keys.robot_alive("*", "*"), keys.server_alive("*")):
            self.server.liveliness().declare_subscriber(expression, self._note_alive)

    def _note(self, sample: zenoh.Sample) -> None:
        self._heard.append((str(sample.key_expr), sample.payload.to_bytes(), sample.kind))

    def _note_alive(self, sample: zenoh.Sample) -> None:
        self._alive.append(str(sample.key_expr))

    def marks(self) -> set[bytes]:
        """All payloads that were heard."""
        return {payload for _, payload, _ in self._heard}

    def reached(self, number: int, attempt: Attempt) -> Iterator[str]:
        """What of an attempt got as far as somebody."""
        if attempt.verb == "put":
            mark = evil(number)
            yield from (key for key, payload, _ in self._heard if payload == mark)
        if attempt.verb == "delete":
            gone = zenoh.SampleKind.DELETE
            yield from (k for k, _, kind in self._heard if kind == gone and k == attempt.key)
        if attempt.verb == "show":
            yield from (key for key in self._alive if key == attempt.key)

    def ask(self, number: int, attempt: Attempt) -> Iterator[str]:
        """Asks what an attempt would answer; the answers that are its own."""
        asker = {"view": self.server, "relative": self.r1, "why": self.r1}
        last = attempt.key.rpartition("/")[2]
        session = asker.get(last, self.wall)
        mark = evil(number)
        yield from ("answered" for payload in replies(session, attempt.key) if payload == mark)


def evil(number: int) -> bytes:
    """What an attempt says."""
    return EVIL + str(number).encode()


def play(session: zenoh.Session, number: int, attempt: Attempt) -> Any:
    """Makes an attempt; returns what must live on for it to last."""
    key, mark = attempt.key, evil(number)
    match attempt.verb:
        case "put":
            session.put(key, mark)
            publisher = session.declare_publisher(key)
            publisher.put(mark)
            publisher.undeclare()
        case "delete":
            session.delete(key)
        case "show":
            return session.liveliness().declare_token(key)
        case "answer":
            return session.declare_queryable(
                key, lambda query: query.reply(query.key_expr, mark), complete=True
            )
        case "listen":
            return session.declare_subscriber(
                key,
                lambda sample: attempt.reached.append(str(sample.key_expr)),
                allowed_origin=zenoh.Locality.REMOTE,
            )
        case "ask":
            own = [f for f in replies(session, key) if not f.startswith(EVIL)]
            attempt.reached += ["an answer"] * len(own)
    return None


def replies(session: zenoh.Session, selector: str) -> list[bytes]:
    """What is answered, by anybody."""
    found = session.get(
        selector,
        timeout=ANSWER_S,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    return [reply.ok.payload.to_bytes() for reply in found if reply.ok is not None]
