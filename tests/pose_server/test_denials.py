"""zenoh's log, read for what rules deny: what it says in advance is no denial, and nobody fills the
tables for others. And what the server makes of it.
"""

import pytest

from fleetpose.pose_server import pipeline
from fleetpose.pose_server.messages import builders
from fleetpose.pose_server.routing.denials import (
    MAX_KINDS_OF_ONE,
    MODULE,
    OTHER_KEYS,
    STRANGER,
    DenialCounts,
)
from fleetpose.pose_server.settings import ServerSettings
from fleetpose.pose_server.state.alarms import MOST_NEWS
from fleetpose.protocol.messages import Denial, Denials
from tests.pose_server.scene import EPOCH
from tests.pose_server.test_flows import site_of

R1, R2 = "8568a66687d2086105e97097ecd8c344", "2cbdedf3ecbaeedcc55e44b9d04f632c"
CLOUD = "fleet/demo/robot/r1/cloud"


def line(said: str, thread: int = 10, level: str = "TRACE") -> str:
    return f"2026-12-02T09:12:16Z {level} rx-1 ThreadId({thread}) {MODULE}: {said}"


def by(session: str, name: str, what: str, key: str = CLOUD, may: str = "unauthorized") -> str:
    subject = f"Interface(lo)+CertCommonName({name})+Transport(Tls)+{session}"
    return f"{session} on {subject} is {may} to {what} on {key}"


KINDS = (
    *("Query", "Reply", "Put", "Delete", "Declare/Undeclare Subscriber"),
    *("Declare/Undeclare Queryable", "Declare/Undeclare Liveliness Token", "Liveliness Query"),
    "Declare Liveliness Subscriber",
)


def in_advance(session: str, name: str, key: str = CLOUD) -> list[str]:
    said = [f"ACL (ingress): caching permissions for `{key}` ..."]
    return said + [by(session, name, f"{kind} (ingress)", key) for kind in KINDS]


def counted(*lines: str) -> dict[tuple[str, str, str], int]:
    counts = DenialCounts()
    assert all(counts.read(one) for one in lines)
    told = counts.message("a", EPOCH).denied
    return {(one.who, one.what, one.key): one.n for one in told}


def test_what_is_worked_out_in_advance_is_no_denial_and_what_follows_is():
    ahead = [line(said) for said in in_advance(R2, "robot/r2")]
    assert counted(*ahead) == {}
    put = line(f"Using cached result: {R2} is unauthorized to Put (ingress) on {CLOUD}")
    assert counted(*ahead, put, put) == {("robot/r2", "Put (ingress)", CLOUD): 2}
    fine = line(f"Using cached result: {R2} is authorized to Put (ingress) on {CLOUD}")
    assert counted(*ahead, fine) == {}


@pytest.mark.parametrize("key", ["fleet/demo/robot/*/cloud", "fleet/demo/robot/**", "**"])
def test_a_put_on_many_keys_at_once_is_told_though_only_its_beginning_is_worked_out(key):
    ahead = [line(said) for said in in_advance(R2, "robot/r2", "fleet/demo/robot")]
    put = line(by(R2, "robot/r2", "Put (ingress)", key))
    assert counted(*ahead, put, put) == {("robot/r2", "Put (ingress)", key): 2}


def test_threads_do_not_disturb_each_other():
    first = [line(said, thread=9) for said in in_advance(R1, "robot/r1")]
    second = [line(said, thread=10) for said in in_advance(R2, "robot/r2")]
    mixed = [one for pair in zip(first, second, strict=True) for one in pair]
    assert counted(*mixed) == {}
    query = by(R2, "robot/r2", "Query (ingress)")
    assert counted(*first[:3], line(query, thread=10)) == {
        ("robot/r2", "Query (ingress)", CLOUD): 1
    }


def test_lives_and_caches_are_one_kind_of_key():
    alive = "fleet/demo/robot/r1/alive/0123456789ab"
    cache = f"{CLOUD}/@adv/pub/{R2}/3/_"
    told = counted(
        *(line(by(R2, "robot/r2", "Put (ingress)", key)) for key in (alive, cache, cache))
    )
    assert set(told) == {
        ("robot/r2", "Put (ingress)", "fleet/demo/robot/r1/alive/*"),
        ("robot/r2", "Put (ingress)", f"{CLOUD}/@adv/pub"),
    }


def test_who_tries_thousands_of_keys_does_not_hide_what_others_do():
    wild = [line(by(R2, "robot/r2", "Put (ingress)", f"fleet/demo/k{k}")) for k in range(3000)]
    told = counted(*wild, line(by(R1, "robot/r1", "Put (ingress)")))
    counts = DenialCounts()
    for one in (*wild, line(by(R1, "robot/r1", "Put (ingress)"))):
        counts.read(one)
    assert counts._denied["robot/r1", "Put (ingress)", CLOUD] == 1
    assert counts._denied["robot/r2", "Put (ingress)", OTHER_KEYS] == 3000 - MAX_KINDS_OF_ONE
    assert len(told) <= 200


@pytest.mark.parametrize(
    ("said", "cause"),
    [
        ("invalid peer certificate: certificate expired: verification time 1 (UNIX)", "expired"),
        ("invalid peer certificate: UnknownIssuer. Hint: increase ...", "of another site"),
        ("peer sent no certificates", "without a certificate"),
        ("received corrupt message of type InvalidContentType. Hint: ...", "without TLS"),
        ("invalid peer certificate: SomethingNew", "SomethingNew"),
    ],
)
def test_a_handshake_that_fails_is_counted_by_its_cause(said, cause):
    counts = DenialCounts()
    assert counts.read(f"2026-12-02T09:12:27Z WARN acc-0 ThreadId(06) zenoh_link_tls: {said}")
    assert counts.message("a", EPOCH).refused == {cause: 1}


def test_a_stranger_is_counted_and_other_lines_are_for_others():
    counts = DenialCounts()
    assert counts.read(line(f"{R1} did not match any configured ACL subject. Default ...", 6))
    assert counts.message("a", EPOCH).refused == {STRANGER: 1}
    assert not counts.read("2026-12-02T09:12:27Z WARN ThreadId(06) zenoh: something else")


# ---- what the server makes of it -----------------------------------------------------------------


def denials(*of: tuple[str, str, int], router: str = "a", **refused: int) -> Denials:
    told = tuple(Denial(who=who, what="Put (ingress)", key=key, n=n) for who, key, n in of)
    return Denials(router=router, epoch=EPOCH, denied=told, refused=refused)


def test_a_name_that_is_denied_is_an_event_once():
    site = site_of()
    for n in (1, 2):
        pipeline.receive_denials(site, denials(("robot/r2", CLOUD, n), expired=n))
    said = [event for event in site.events if "router a" in event]
    assert len(said) == 2
    assert "router a denies robot/r2: Put (ingress) on fleet/demo/robot/r1/cloud" in said[0]
    assert said[1].endswith("router a turns away who comes: expired")


def test_many_names_at_once_do_not_displace_all_events():
    site = site_of()
    pipeline.receive_denials(site, denials(*((f"robot/x{k}", CLOUD, 1) for k in range(100))))
    assert sum("router a" in event for event in site.events) == MOST_NEWS


def test_a_robot_whose_views_are_denied_reads_so():
    site = site_of()
    pipeline.receive_token(site, "r1", EPOCH, True)
    pipeline.receive_denials(site, denials(("robot/r1#2", CLOUD, 3)))
    pipeline.receive_denials(site, denials(("robot/r1#2", CLOUD, 4), router="b"))
    pipeline.receive_denials(site, denials(("robot/r2", CLOUD, 9), router="c"))
    why = builders.why_not(site, "r1", ServerSettings(), 0.0).why_not
    assert why == "alive, but its router's rules deny its views, 7 so far"
    assert site.denials.denied[0].who == "robot/r2" and site.denials.refused == {}
