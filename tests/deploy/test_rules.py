"""The rules that follow from the one policy: who may say what, for every process and every key.

They are read as a router reads them, so that a wrong translation of the policy is seen as well.
"""

import json
import time

import pytest

from fleetpose.deploy.identity import Identity
from fleetpose.deploy.site.configuration import rules_hash
from fleetpose.deploy.site.explain import VERBS, allowing, explain
from fleetpose.deploy.site.folder import Site
from fleetpose.deploy.site.issuing import router_configurations
from fleetpose.deploy.site.limits import Rates, limits
from fleetpose.deploy.site.rules import EGRESS, INGRESS, MESSAGES, access_control, includes
from fleetpose.protocol.keys import EVERY_SERVER, Keys

K = Keys("demo")
E = "0123456789ab"
R1, R2 = Identity("robot", "r1"), Identity("robot", "r2")
SERVER, ANNA, WALL = (
    Identity("server", "server"),
    Identity("operator", "anna"),
    Identity("observer", "wall"),
)
LOG = Identity("recorder", "log")
SITE = Site(
    site="demo",
    routers={"a": "h"},
    robots=("r1", "r2"),
    operators=("anna",),
    observers=("wall",),
    recorders=("log",),
)
ACCESS = access_control(K, SITE.members())

SAID = {  # what each process says and hears when all goes well
    SERVER: {
        "put": [
            *(K.pose("r1"), K.state, K.status, K.receipts("anna"), K.heard("r1")),
            *(K.alignment("r1", "r2"), K.correspondences("r1", "r2")),
        ],
        "subscribe": [
            *(K.camera("*"), K.cloud("*"), K.odometry("*")),
            *(K.updates("*"), K.selection("*")),
        ],
        "hear": [
            *(K.camera("r1"), K.cloud("r1"), K.odometry("r1")),
            *(K.updates("anna"), K.selection("anna")),
        ],
        "ask": [K.view("r1")],
        "answer": [K.relative, K.why, K.server_view],
        "show": [K.server_alive(E)],
        "see": [K.server_alive("*"), K.robot_alive("*", "*")],
    },
    R1: {
        "put": [K.camera("r1"), K.odometry("r1"), K.cloud("r1"), K.image("r1")],
        "subscribe": [K.poses, K.heard("r1")],
        "hear": [K.pose("r1"), K.pose("r2"), K.heard("r1")],
        "ask": [K.relative, K.why],
        "answer": [K.view("r1")],
        "show": [K.robot_alive("r1", E)],
        "see": [K.robot_alive("r1", "*"), K.server_alive("*"), EVERY_SERVER],
    },
    ANNA: {
        "put": [K.updates("anna"), K.selection("anna")],
        "subscribe": [
            *(K.state, K.status, K.poses, K.alignment("*", "*"), K.correspondences("*", "*")),
            *(K.receipts("anna"), K.selection("*"), K.camera("*"), K.image("r1")),
        ],
        "ask": [K.view("r1"), K.server_view, K.why],
        "see": [K.server_alive("*")],
    },
    WALL: {
        "subscribe": [K.state, K.status, K.poses, K.selection("*"), K.camera("*"), K.image("r2")],
        "ask": [K.view("r2"), K.why],
    },
    LOG: {
        "subscribe": [
            *(K.camera("*"), K.odometry("*"), K.cloud("*"), K.image("*"), K.heard("*")),
            *(K.updates("*"), K.selection("*"), K.receipts("*"), K.denials("*")),
            *(K.poses, K.state, K.status, K.alignment("*", "*"), K.correspondences("*", "*")),
        ],
        "hear": [
            *(K.camera("r1"), K.odometry("r1"), K.cloud("r1"), K.image("r1"), K.pose("r1")),
            *(K.updates("anna"), K.receipts("anna"), K.correspondences("r1", "r2"), K.state),
        ],
        "see": [K.server_alive("*"), K.robot_alive("*", "*")],
    },
}
ALL_KEYS = (
    *(K.camera("r1"), K.odometry("r1"), K.cloud("r1"), K.image("r1"), K.view("r1")),
    *(K.robot_alive("r1", E), K.pose("r1"), K.heard("r1"), K.state, K.status, K.server_alive(E)),
    *(K.relative, K.why, K.server_view, K.receipts("anna"), K.updates("anna"), K.selection("anna")),
    *(K.alignment("r1", "r2"), K.correspondences("r1", "r2"), K.denials("a")),
)


def may(who: Identity, verb: str, key: str) -> bool:
    return explain(ACCESS, who, verb, key).allowed


@pytest.mark.parametrize("who", SAID, ids=lambda who: who.who)
def test_each_process_may_do_what_it_does(who):
    denied = [
        f"{verb} {key}"
        for verb, keys in SAID[who].items()
        for key in keys
        if not may(who, verb, key)
    ]
    assert not denied


@pytest.mark.parametrize("verb", ["put", "delete", "answer", "show"])
def test_nobody_says_what_is_not_its_own(verb):
    said = {
        (who.who, key)
        for who in (R1, R2, SERVER, ANNA, WALL, LOG)
        for key in ALL_KEYS
        if may(who, verb, key)
    }
    told = {(who.who, key) for who in SAID for key in SAID[who].get(verb, ())}
    assert said <= told


def test_nobody_deletes_anything():
    assert not list(allowing(ACCESS, "server", INGRESS, "delete"))


@pytest.mark.parametrize("who", [R2, WALL, ANNA, LOG], ids=lambda who: who.who)
@pytest.mark.parametrize("verb", ["put", "answer", "show"])
def test_no_wildcard_lets_somebody_speak_for_another(who, verb):
    flow, message = VERBS[verb]
    for _, expression in allowing(ACCESS, who.common_name, flow, message):
        own = f"/{who.name}/" in expression
        assert own and "**" not in expression.replace("/@adv/pub/**", ""), expression


def test_a_latched_key_costs_what_its_publisher_and_its_readers_need():
    """Its token, cache and heartbeats; the cache answers under the plain key."""
    key, beside = K.camera("r1"), f"{K.camera('r1')}/@adv/pub/abc/7/_"
    read = K.camera("*")

    def allowed(who: Identity, flow: str, message: str, expression: str) -> bool:
        mine = allowing(ACCESS, who.common_name, flow, message)
        return any(includes(one, expression) for _, one in mine)

    writer = {
        (INGRESS, "put"): (key, beside),
        (INGRESS, "liveliness_token"): (beside,),
        (INGRESS, "declare_queryable"): (beside,),
        (INGRESS, "reply"): (key,),
        (EGRESS, "query"): (f"{read}/@adv/pub/**", f"{read}/@adv/**"),
        (EGRESS, "declare_subscriber"): (read, f"{read}/@adv/pub/**"),
    }
    reader = {
        (INGRESS, "declare_subscriber"): (read, f"{read}/@adv/pub/**"),
        (EGRESS, "put"): (key, beside),
        (INGRESS, "declare_liveliness_subscriber"): (f"{read}/@adv/pub/**",),
        (EGRESS, "liveliness_token"): (beside,),
        (INGRESS, "query"): (f"{read}/@adv/**",),
        (EGRESS, "reply"): (key,),
    }
    for who, needed in ((R1, writer), (ANNA, reader)):
        for (flow, message), expressions in needed.items():
            assert all(allowed(who, flow, message, one) for one in expressions), (flow, message)
    assert not allowed(R2, INGRESS, "reply", key) and not allowed(R2, INGRESS, "put", beside)


def test_a_generation_alone_counts():
    later = SITE.with_generation(R1.of_generation(2))
    access = access_control(K, later.members())
    assert not explain(access, R1, "put", K.cloud("r1")).allowed
    assert explain(access, R1.of_generation(2), "put", K.cloud("r1")).allowed


def test_rules_follow_from_what_site_toml_says_and_from_nothing_else():
    assert router_configurations(SITE) == router_configurations(SITE)
    told = router_configurations(SITE)["a"]["metadata"]["fleetpose"]
    assert told["rules"] == rules_hash(ACCESS, limits(K, SITE.rates))
    faster = SITE.model_copy(update={"rates": Rates(views_hz=6.0)})
    assert router_configurations(faster)["a"]["metadata"]["fleetpose"]["rules"] != told["rules"]


def test_operators_clicks_are_never_thinned_out():
    rules = [rule for part in limits(K, Rates())["downsampling"] for rule in part["rules"]]
    for key in (K.updates("anna"), K.receipts("anna"), f"{K.updates('anna')}/@adv/pub/x/1/_"):
        assert not any(includes(rule["key_expr"], key) for rule in rules)


def test_rules_of_a_large_site_are_made_in_seconds_and_stay_small():
    robots = tuple(f"r{n}" for n in range(300))
    began = time.monotonic()
    made = router_configurations(SITE.model_copy(update={"robots": robots}))["a"]
    assert time.monotonic() - began < 10
    assert len(json.dumps(made)) < 2_000_000
    assert len(made["access_control"]["subjects"]) == len(robots) + 6


def test_every_rule_is_of_one_direction_and_messages_that_zenoh_knows():
    for rule in ACCESS["rules"]:
        assert rule["permission"] == "allow" and rule["flows"] in ([INGRESS], [EGRESS])
        assert set(rule["messages"]) <= set(MESSAGES) and rule["key_exprs"]
    used = {name for policy in ACCESS["policies"] for name in policy["rules"]}
    assert used == {rule["id"] for rule in ACCESS["rules"]}
