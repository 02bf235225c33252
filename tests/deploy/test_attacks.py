"""What a member of the site can do with its certificate beyond what it is there for: nothing.

Every attack is played by a raw zenoh session against a router that runs generated rules; after it a
message that may pass shows that everything before it had its chance.
"""

import secrets
import time
from collections.abc import Iterable
from contextlib import ExitStack

import pytest
import zenoh
from zenoh import ext

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.deploy.manifest import CA, CERTIFICATE, CONFIGURATION, KEY
from fleetpose.deploy.site.certificates import Authority
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import free_port, wait_until
from tests.deploy.field_makers import Field, opened

HEARD_S = 30.0
EVIL = b"EVIL"
K = Keys("demo")

OF_SERVER = (
    *(K.cloud("*"), K.odometry("*"), K.updates("*"), K.selection("*"), K.denials("*")),
    *(K.alignment("*", "*"), K.correspondences("*", "*")),
)
OF_OBSERVER = (
    *(K.poses, K.state, K.status, K.camera("*"), K.image("*")),
    *(K.alignment("*", "*"), K.correspondences("*", "*"), K.selection("*")),
    K.check("observer", "wall", "*"),
)


class Tap:
    """Everything that members who may hear it get from the router."""

    def __init__(self, *sessions: tuple[zenoh.Session, Iterable[str]]) -> None:
        self.heard: list[tuple[str, bytes, zenoh.SampleKind]] = []
        self._subscribers = [
            session.declare_subscriber(key, self._note)
            for session, keys in sessions
            for key in keys
        ]

    def _note(self, sample: zenoh.Sample) -> None:
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes(), sample.kind))

    def evil(self) -> list[str]:
        return [key for key, payload, _ in self.heard if payload.startswith(EVIL)]

    def deleted(self) -> list[str]:
        return [key for key, _, kind in self.heard if kind == zenoh.SampleKind.DELETE]

    def wait_passed(self, session: zenoh.Session, *keys: str) -> None:
        """Puts what may pass until it is heard: all that was put before it has passed, or not."""
        mark = secrets.token_bytes(8)

        def passed() -> bool:
            for key in keys:
                session.put(key, mark)
            return {key for key, payload, _ in self.heard if payload == mark} == set(keys)

        assert wait_until(passed, HEARD_S, poll_s=0.1), f"{keys} should have passed"


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    return Field(tmp_path_factory.mktemp("field"))


@pytest.fixture(scope="module")
def router_process(field):
    with LocalFleet(field.folder / "logs") as fleet:
        config = field.configuration("router/a")
        fleet.endpoint = f"tcp/127.0.0.1:{field.router().port}"
        fleet.start("router", "fleetpose.pose_server", "router", "--config", str(config))
        fleet.wait_accepting()
        yield fleet


@pytest.fixture(scope="module")
def sessions(field, router_process):
    """Sessions of members, by who they are."""
    with ExitStack() as closing:
        found = {}
        for who in ("server", "robot/r1", "robot/r2", "operator/anna", "operator/ben"):
            found[who] = field.open(who)
        found["observer/wall"] = field.open("observer/wall")
        for session in found.values():
            closing.callback(session.close)
        yield found


@pytest.fixture(scope="module")
def tap(sessions):
    tap = Tap(
        (sessions["server"], OF_SERVER),
        (sessions["observer/wall"], OF_OBSERVER),
        (sessions["robot/r1"], (K.heard("r1"), K.check("robot", "r1", "*"))),
        (sessions["operator/anna"], (K.receipts("anna"),)),
    )
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"), K.image("r2"), K.odometry("r2"))
    return tap


def attack(session: zenoh.Session, *keys: str) -> None:
    """Puts by the session and by declared publishers, as programs do."""
    for key in keys:
        session.put(key, EVIL + b" put")
        publisher = session.declare_publisher(key)
        publisher.put(EVIL + b" published")
        publisher.undeclare()


ATTACKS_OF_R2 = {
    "another robot's data": (K.cloud("r1"), K.camera("r1"), K.image("r1"), K.odometry("r1")),
    "poses, its own too": (K.pose("r1"), K.pose("r2")),
    "what the server says": (K.state, K.status, K.heard("r1"), K.receipts("anna")),
    "alignments and sets": (K.alignment("r1", "r2"), K.correspondences("r1", "r2")),
    "operators' clicks": (K.updates("anna"), K.selection("anna"), K.updates("r2")),
    "what routers say": (K.denials("a"),),
    "wildcards": (K.cloud("*"), f"{K.root}/robot/**", "**"),
    "another's heartbeats": (f"{K.camera('r1')}/@adv/pub/{'a' * 32}/7/_",),
    "another's check": (K.check("robot", "r1", "x"),),
    "another site": (Keys("other").cloud("r2"),),
    "the router's configuration": ("@/*/router/config/access_control/enabled",),
}


@pytest.mark.parametrize("keys", ATTACKS_OF_R2.values(), ids=ATTACKS_OF_R2.keys())
def test_a_robot_says_nothing_but_its_own(sessions, tap, keys):
    attack(sessions["robot/r2"], *keys)
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"), K.image("r2"))
    assert tap.evil() == []


def test_a_robot_deletes_nothing(sessions, tap):
    for key in (K.cloud("r1"), K.cloud("r2"), K.camera("r2"), K.pose("r1")):
        sessions["robot/r2"].delete(key)
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"), K.image("r2"))
    assert tap.deleted() == []


def test_an_attack_that_is_allowed_would_be_seen(sessions, tap):
    """The same puts by who may do them are heard, each of them."""
    before = len(tap.heard)
    attack(sessions["server"], K.pose("r1"), K.state, K.heard("r1"), K.receipts("anna"))
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"), K.image("r2"))
    seen = {key for key, _, _ in tap.heard[before:]}
    assert {K.pose("r1"), K.state, K.heard("r1"), K.receipts("anna")} <= seen
    del tap.heard[before:]


@pytest.mark.parametrize(
    ("who", "own"),
    [("observer/wall", K.check("observer", "wall", "x")), ("operator/ben", K.updates("ben"))],
)
def test_who_looks_says_nothing_and_an_operator_nothing_of_another(field, tap, who, own):
    keys = (K.updates("anna"), K.selection("anna"), K.updates("wall"), K.selection("wall"))
    with field.open(who) as session:  # what a session hears of itself does not pass the router
        attack(session, *keys, K.state, K.pose("r1"), K.cloud("r1"), K.camera("r1"))
        tap.wait_passed(session, own)
    assert tap.evil() == []


def test_a_robot_shows_no_token_but_its_own(sessions):
    seen: list[str] = []
    watchers = [
        sessions["server"]
        .liveliness()
        .declare_subscriber(key, lambda s: seen.append(str(s.key_expr)), history=True)
        for key in (K.robot_alive("*", "*"), K.server_alive("*"))
    ]
    shown = (K.robot_alive("r1", "a" * 12), K.robot_alive("r9", "b" * 12), K.server_alive("c" * 12))
    tokens = [sessions["robot/r2"].liveliness().declare_token(key) for key in shown]
    own = K.robot_alive("r2", "d" * 12)
    tokens.append(sessions["robot/r2"].liveliness().declare_token(own))
    assert wait_until(lambda: own in seen, HEARD_S)
    assert seen == [own]
    for declared in (*tokens, *watchers):
        declared.undeclare()


def replies(session: zenoh.Session, selector: str) -> list[bytes]:
    """What is answered, by anybody."""
    found = session.get(
        selector,
        timeout=2.0,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
    )
    return [reply.ok.payload.to_bytes() for reply in found if reply.ok is not None]


def test_a_robot_answers_no_questions_to_others(sessions, tap):
    asked: list[str] = []

    def answer(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        query.reply(query.key_expr, EVIL)

    keys = (K.view("r1"), K.relative, K.why, K.server_view)
    answering = [sessions["robot/r2"].declare_queryable(key, answer, complete=True) for key in keys]
    own = sessions["robot/r2"].declare_queryable(
        K.view("r2"), lambda query: query.reply(query.key_expr, b"mine")
    )
    server, r1 = sessions["server"], sessions["robot/r1"]
    assert wait_until(lambda: replies(server, K.view("r2")) == [b"mine"], HEARD_S)
    assert replies(server, K.view("r1")) == []
    assert replies(r1, f"{K.relative}?from=r1;to=r2") == replies(r1, f"{K.why}?robot=r1") == []
    assert replies(sessions["observer/wall"], f"{K.server_view}?robot=r1") == []
    assert asked == []
    for declared in (*answering, own):
        declared.undeclare()


def test_a_robot_forges_no_latched_message_through_a_cache(sessions, tap):
    """A cache shows a token and answers; the router lets neither through under another's key.

    The robot may be asked for it, by a question to all caches; its answer does not pass.
    """
    r2 = sessions["robot/r2"]
    cache = f"{K.camera('r1')}/@adv/pub/{r2.info.zid()}/7/_"

    def answer(query: zenoh.Query) -> None:
        query.reply(K.camera("r1"), EVIL)

    forged = (r2.declare_queryable(cache, answer), r2.liveliness().declare_token(cache))
    own = ext.declare_advanced_publisher(
        r2, K.camera("r2"), cache=ext.CacheConfig(max_samples=1), publisher_detection=True
    )
    own.put(b"mine")
    got: list[tuple[str, bytes]] = []
    late = ext.declare_advanced_subscriber(
        sessions["observer/wall"],
        K.camera("*"),
        lambda sample: got.append((str(sample.key_expr), sample.payload.to_bytes())),
        history=ext.HistoryConfig(detect_late_publishers=True),
        recovery=ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
    )
    assert wait_until(lambda: (K.camera("r2"), b"mine") in got, HEARD_S), "a true cache answers"
    ask = f"{K.camera('*')}/@adv/**?_anyke"
    assert replies(sessions["observer/wall"], ask) == [b"mine"]
    assert {key for key, _ in got} == {K.camera("r2")}
    for declared in (*forged, own, late):
        declared.undeclare()


def test_a_robot_hears_poses_and_nothing_else(sessions, tap):
    got: list[str] = []
    everything = (
        *(K.image("r1"), K.cloud("r1"), f"{K.root}/robot/**", f"{K.root}/operator/**"),
        *(f"{K.root}/**", "**", K.heard("r1")),
    )
    r2 = sessions["robot/r2"]
    listening = [
        r2.declare_subscriber(key, lambda s: got.append(str(s.key_expr)))
        for key in (*everything, K.poses)
    ]
    tap.wait_passed(sessions["robot/r1"], K.cloud("r1"), K.image("r1"), K.odometry("r1"))
    tap.wait_passed(sessions["operator/anna"], K.updates("anna"), K.selection("anna"))
    sessions["server"].put(K.heard("r1"), b"")
    assert wait_until(lambda: sessions["server"].put(K.pose("r1"), b"") or K.pose("r1") in got, 30)
    assert set(got) == {K.pose("r1")}
    for declared in listening:
        declared.undeclare()


def test_a_robot_sees_no_tokens_but_its_own_and_the_servers(sessions):
    server, r1, r2 = (sessions[who] for who in ("server", "robot/r1", "robot/r2"))
    shown = [r1.liveliness().declare_token(K.robot_alive("r1", "a" * 12))]
    shown.append(server.liveliness().declare_token(K.server_alive("b" * 12)))

    def seen(session: zenoh.Session, key: str) -> int:
        return len([r for r in session.liveliness().get(key, timeout=2) if r.ok is not None])

    assert wait_until(lambda: seen(server, K.robot_alive("*", "*")) == 1, HEARD_S)
    assert wait_until(lambda: seen(r2, K.server_alive("*")) == 1, HEARD_S)
    assert seen(r2, "**") == seen(r2, K.robot_alive("*", "*")) == 0
    assert seen(r2, K.robot_alive("r1", "*")) == 0
    for token in shown:
        token.undeclare()


def test_nobody_but_the_keeper_reads_the_routers_admin_space(field, sessions):
    health = field.open("health/desk")
    try:
        assert len(replies(health, "@/*/router")) == 1
        for who in ("robot/r2", "observer/wall", "operator/anna", "server"):
            for key in ("@/*/router", "@/*/router/**"):
                assert replies(sessions[who], key) == []
        assert replies(health, "@/*/router/config/**") == []
    finally:
        health.close()


@pytest.mark.parametrize("mode", ["peer", "router"])
def test_rules_hold_for_whoever_calls_himself_a_peer_or_a_router(field, sessions, tap, mode):
    def change(told):
        told["mode"] = mode
        told["listen"] = {"endpoints": []}

    with field.open("robot/r2", change) as session:
        attack(session, K.cloud("r1"), K.pose("r1"), K.state, K.updates("anna"))
        tap.wait_passed(session, K.cloud("r2"), K.image("r2"))
        assert tap.evil() == []


def test_the_servers_session_number_gives_nothing(field, sessions, tap):
    """It is in the timestamp of every pose; while the server lives it lets nobody else in."""
    stolen = str(sessions["server"].info.zid())
    with pytest.raises(zenoh.ZError):
        field.open("robot/r2", lambda told: told.update(id=stolen))
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"))


def test_a_robots_certificate_is_no_routers(field):
    """Others refuse to connect to it, also where they do not look at the host's name."""
    port = free_port()
    folder = field.install("robot/r2")

    def as_router(told):
        told["mode"], told["connect"] = "router", {"endpoints": []}
        told["listen"] = {"endpoints": [f"tls/127.0.0.1:{port}"]}
        tls = told["transport"]["link"]["tls"]
        tls["listen_private_key"] = str(folder / KEY)
        tls["listen_certificate"] = str(folder / CERTIFICATE)

    def without_name(told):
        told["connect"]["endpoints"] = [f"tls/127.0.0.1:{port}"]
        told["transport"]["link"]["tls"]["verify_name_on_connect"] = False

    with opened(folder / CONFIGURATION, as_router), pytest.raises(zenoh.ZError):
        field.open("robot/r1", without_name)


def test_an_operator_neither_hears_nor_asks_another_ones_updates(sessions, tap):
    anna, ben = sessions["operator/anna"], sessions["operator/ben"]
    updates = ext.declare_advanced_publisher(
        anna, K.updates("anna"), cache=ext.CacheConfig(max_samples=9), publisher_detection=True
    )
    updates.put(b"a click")
    got: list[str] = []
    listening = [
        ben.declare_subscriber(key, lambda s: got.append(str(s.key_expr)))
        for key in (K.updates("anna"), K.updates("*"), K.receipts("anna"), K.selection("*"))
    ]
    tap.wait_passed(anna, K.updates("anna"), K.selection("anna"))
    assert wait_until(
        lambda: replies(sessions["server"], f"{K.updates('*')}/@adv/**?_anyke"), HEARD_S
    )
    assert replies(ben, f"{K.updates('anna')}/@adv/**?_anyke") == []
    anna.put(K.selection("anna"), b"last")
    assert wait_until(lambda: K.selection("anna") in got, HEARD_S)
    assert set(got) == {K.selection("anna")}
    for declared in (updates, *listening):
        declared.undeclare()


def refused(field: Field, name: str, issued, ca: bytes | None = None) -> None:
    folder = field.with_certificate(name, issued)
    if ca is not None:
        (folder / CA).write_bytes(ca)
    with pytest.raises(zenoh.ZError):
        opened(folder / CONFIGURATION)


R1 = Identity("robot", "r1")


def test_an_expired_certificate_is_refused(field, router_process):
    refused(field, "expired", field.keeper.folder.authority().issue(R1, days=-0.01))


def test_a_certificate_of_tomorrow_is_refused(field, router_process):
    from datetime import UTC, datetime, timedelta

    tomorrow = datetime.now(UTC) + timedelta(days=1)
    refused(field, "early", field.keeper.folder.authority().issue(R1, days=9, now=tomorrow))


@pytest.mark.parametrize("site", ["other", "demo"])
@pytest.mark.parametrize("trusts", ["the router", "its own"])
def test_another_site_is_refused_also_one_of_the_same_name(field, router_process, site, trusts):
    other = Authority.make(site)
    ca = other.pem if trusts == "its own" else None
    refused(field, f"other-{site}-{bool(ca)}", other.issue(R1, days=9), ca)


def test_who_signs_for_himself_is_refused(field, router_process):
    """A robot that uses its certificate as an authority has none."""
    alone = Authority.make("demo")
    own = Identity("robot", "r2")
    refused(field, "self", alone.issue(own, days=9))


def test_who_shows_no_certificate_or_speaks_no_tls_is_refused(field, router_process):
    def nothing(told):
        tls = told["transport"]["link"]["tls"]
        for name in ("connect_private_key", "connect_certificate"):
            del tls[name]
        tls["enable_mtls"] = False

    def plain(told):
        told["transport"]["link"]["protocols"] = ["tcp"]
        told["connect"]["endpoints"] = [f"tcp/127.0.0.1:{field.router().port}"]

    for change in (nothing, plain):
        with pytest.raises(zenoh.ZError):
            field.open("robot/r1", change)


def test_a_router_under_another_host_name_is_refused(field, router_process):
    def elsewhere(told):
        told["connect"]["endpoints"] = [f"tls/localhost:{field.router().port}"]

    with pytest.raises(zenoh.ZError):
        field.open("robot/r1", elsewhere)


@pytest.mark.parametrize("who", [Identity("robot", "r9"), Identity("robot", "r1", 2)])
def test_a_certificate_that_the_rules_do_not_know_connects_and_passes_nothing(
    field, sessions, tap, who
):
    issued = field.keeper.folder.authority().issue(who, days=9)
    folder = field.with_certificate(f"unknown-{who.folder}-{who.generation}", issued)
    with opened(folder / CONFIGURATION) as session:
        got: list[str] = []
        others = zenoh.Locality.REMOTE
        session.declare_subscriber(
            "**", lambda s: got.append(str(s.key_expr)), allowed_origin=others
        )
        attack(session, K.cloud(who.name), K.cloud("r2"), K.pose("r1"), K.updates("anna"), "**")
        assert replies(session, K.view("r1")) == replies(session, "@/*/router") == []
        tap.wait_passed(sessions["robot/r2"], K.cloud("r2"), K.image("r2"))
        assert tap.evil() == [] and got == []


def test_a_flood_of_odometry_is_thinned_out_by_the_router(field, sessions, tap):
    before, began = len(tap.heard), time.monotonic()
    for _ in range(5000):
        sessions["robot/r2"].put(K.odometry("r2"), b"flood")
    tap.wait_passed(sessions["robot/r2"], K.cloud("r2"))
    took = time.monotonic() - began
    passed = sum(payload == b"flood" for _, payload, _ in tap.heard[before:])
    assert 1 <= passed <= field.site.rates.odometry_hz * took + 2


def test_what_is_too_large_for_its_key_does_not_pass(field, sessions, tap):
    rates = field.site.rates
    r2 = sessions["robot/r2"]
    for key, size in ((K.odometry("r2"), rates.small_bytes), (K.cloud("r2"), rates.view_bytes)):
        tap.wait_passed(r2, key)
        r2.put(key, EVIL + bytes(size))
    tap.wait_passed(r2, K.image("r2"), K.cloud("r2"))
    assert tap.evil() == []
