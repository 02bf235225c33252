"""What a router's rules deny and whom it does not let in, read from zenoh's log.

zenoh tells denials at trace level only, and has no other way to count them. It works out in advance
what a session may do with a key, and tells that in the same words: these lines, nine after each
`caching permissions`, are no denials. What a router thins out is dropped before its rules see it:
of puts faster than that, also on `**`, only some are told.
"""

import re
import threading
from collections import Counter
from dataclasses import dataclass, field

from fleetpose.protocol.messages import Denial, Denials
from fleetpose.protocol.text import one_line

MODULE = "zenoh::net::routing::interceptor::access_control"
MOST_TOLD = 200
MAX_KINDS = 10_000
MAX_KINDS_OF_ONE = 200  # who tries thousands of keys must not hide what others do
MAX_SESSIONS = 10_000
OTHER_KEYS = "other keys"
_IN_ADVANCE = frozenset(
    {
        *("Query", "Reply", "Put", "Delete"),
        *("Declare/Undeclare Subscriber", "Declare/Undeclare Queryable"),
        *("Declare/Undeclare Liveliness Token", "Liveliness Query"),
        "Declare Liveliness Subscriber",
    }
)
_LINE = re.compile(rf"(ThreadId\(\d+\)) {re.escape(MODULE)}: (.*)", re.DOTALL)
_AHEAD = re.compile(r"ACL \((ingress|egress)\): caching permissions for `(.+)` \.\.\.")
_SAID = re.compile(
    r"(Using cached result: )?([0-9a-f]+)(?: on (\S+))? is (un)?authorized to "
    r"(.+?) \((ingress|egress)\) on (.+)"
)
_NAME = re.compile(r"CertCommonName\((.+?)\)(?:\+|$)")
_REFUSED = re.compile(
    r"invalid peer certificate: ([A-Za-z ]+)"
    r"|(peer sent no certificates|received corrupt message of type InvalidContentType)"
)
_CAUSES = {
    "certificate expired": "expired",
    "Expired": "expired",
    "certificate not valid yet": "not valid yet",
    "NotValidYet": "not valid yet",
    "UnknownIssuer": "of another site",
    "BadSignature": "of another authority with this site's name",
    "peer sent no certificates": "without a certificate",
    "received corrupt message of type InvalidContentType": "without TLS",
}
STRANGER = "a certificate that the rules do not know"


@dataclass
class DenialCounts:
    """Counts lines of zenoh's log. One thread reads, another may ask for the message."""

    refused: Counter[str] = field(default_factory=Counter)
    _denied: Counter[tuple[str, str, str]] = field(default_factory=Counter)
    _kinds_of: Counter[str] = field(default_factory=Counter)
    _names: dict[str, str] = field(default_factory=dict)  # of certificates, by session
    _ahead: dict[str, tuple[str, str, set[str]]] = field(default_factory=dict)  # by thread
    _guard: threading.Lock = field(default_factory=threading.Lock)

    def read(self, line: str) -> bool:
        """Takes a line; whether it was about rules or handshakes, and is good for nothing more."""
        with self._guard:
            return self._read(line)

    def _read(self, line: str) -> bool:
        found = _LINE.search(line)
        if found is None:
            return self._refused_in(line)
        thread, said = found[1], found[2].rstrip()
        if "did not match any configured ACL subject" in said:
            self.refused[STRANGER] += 1
        elif ahead := _AHEAD.match(said):
            self._ahead[thread] = (ahead[1], ahead[2], set(_IN_ADVANCE))
        elif told := _SAID.match(said):
            cached, session, subject, denied, what, flow, key = told.groups()
            self._learn(session, subject)
            if not self._was_ahead(thread, cached, what, flow, key) and denied:
                self._count(self._names.get(session, session), f"{what} ({flow})", key)
        return True

    def message(self, router: str, epoch: str) -> Denials:
        """What is told of it."""
        with self._guard:
            most, refused = self._denied.most_common(MOST_TOLD), dict(self.refused)
        denied = (Denial(who=who, what=what, key=key, n=n) for (who, what, key), n in most)
        return Denials(router=router, epoch=epoch, denied=tuple(denied), refused=refused)

    def _refused_in(self, line: str) -> bool:
        found = _REFUSED.search(line)
        if found is not None:
            said = (found[1] or found[2]).strip()
            self.refused[_CAUSES.get(said, said)[:80]] += 1
        return found is not None

    def _learn(self, session: str, subject: str | None) -> None:
        name = None if subject is None else _NAME.search(subject)
        if name is not None and self._names.get(session) != name[1]:
            if len(self._names) >= MAX_SESSIONS:
                del self._names[next(iter(self._names))]
            self._names[session] = name[1]

    def _was_ahead(self, thread: str, cached: str | None, what: str, flow: str, key: str) -> bool:
        """Whether a line is one of those that zenoh says in advance."""
        ahead = self._ahead.get(thread)
        if ahead is None:
            return False
        if cached is None and ahead[:2] == (flow, key) and what in ahead[2]:
            ahead[2].remove(what)
            return True
        del self._ahead[thread]
        return False

    def _count(self, who: str, what: str, key: str) -> None:
        who, key = one_line(who, 100), kind_of(one_line(key, 200))
        kind = (who, what, key)
        if kind not in self._denied:
            full = len(self._denied) >= MAX_KINDS or self._kinds_of[who] >= MAX_KINDS_OF_ONE
            if full:
                kind = (who, what, OTHER_KEYS)
            else:
                self._kinds_of[who] += 1
        if kind in self._denied or len(self._denied) < 2 * MAX_KINDS:
            self._denied[kind] += 1


def kind_of(key: str) -> str:
    """A key without what is drawn anew for each life of a process."""
    key = re.sub(r"/@adv/(pub|sub)/.*", r"/@adv/\1", key)
    return re.sub(r"/alive/[0-9a-f]{12}\b", "/alive/*", key)
