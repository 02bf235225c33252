"""Certificates and rules change while sessions stand: nobody but a router is started again."""

import secrets
import time
from contextlib import ExitStack

import pytest
import zenoh

from fleetpose.deploy.machine.check import State, check
from fleetpose.protocol.keys import Keys
from fleetpose.protocol.transport import wait_until
from tests.deploy.field_makers import Field

K = Keys("demo")
BACK_S = 60.0


@pytest.fixture
def field(tmp_path):
    return Field(tmp_path)


class Hearing:
    """What the server hears of one robot's clouds."""

    def __init__(self, server: zenoh.Session, robot: str) -> None:
        self._heard: list[bytes] = []
        self.key = K.cloud(robot)
        self._kept = server.declare_subscriber(
            self.key, lambda sample: self._heard.append(sample.payload.to_bytes())
        )

    def of(self, session: zenoh.Session, within_s: float = BACK_S) -> bool:
        """Whether what a session puts arrives within a time."""
        mark = secrets.token_bytes(8)

        def arrived() -> bool:
            session.put(self.key, mark)
            return mark in self._heard

        return wait_until(arrived, within_s, poll_s=0.1)


def test_who_is_revoked_passes_nothing_and_everybody_else_goes_on(field):
    router = field.start_router()
    with ExitStack() as closing:
        server, r1, r2 = (
            closing.enter_context(field.open(who)) for who in ("server", "robot/r1", "robot/r2")
        )
        of_r1, of_r2 = Hearing(server, "r1"), Hearing(server, "r2")
        assert of_r1.of(r1) and of_r2.of(r2)
        field.keeper.revoke(field.site.member("robot/r2"))
        assert of_r2.of(r2), "a router knows only after it was started again"
        router.close()
        router = field.start_router()
        closing.callback(router.close)
        assert of_r1.of(r1), "links come back by themselves"
        assert not of_r2.of(r2, 2.0)
        field.keeper.renew([field.site.member("robot/r2")])
        with field.open("robot/r2") as renewed:
            assert of_r2.of(renewed)
        assert not of_r2.of(r2, 1.0)


def test_what_is_renewed_in_place_is_read_when_the_link_comes_back(field):
    """The rules know the new generation alone, so a session that passes has read the new files."""
    router = field.start_router()
    with field.open("server") as server, field.open("robot/r1") as r1:
        hearing = Hearing(server, "r1")
        assert hearing.of(r1)
        field.keeper.revoke(field.site.member("robot/r1"))
        field.keeper.renew([field.site.member("robot/r1")])
        field.install("robot/r1")
        assert hearing.of(r1), "the link that stands is not touched"
        router.close()
        router = field.start_router()
        try:
            assert hearing.of(r1)
        finally:
            router.close()


def test_a_certificate_that_expires_ends_its_link(field):
    with field.start_router(), field.open("server") as server:
        field.keeper.renew([field.site.member("robot/r1")], days=6.0 / 86400)
        with field.open("robot/r1") as r1:
            hearing = Hearing(server, "r1")
            assert hearing.of(r1)
            assert wait_until(lambda: not list(r1.info.routers_zid()), BACK_S)
            assert not hearing.of(r1, 1.0)
            field.keeper.renew([field.site.member("robot/r1")])
            field.install("robot/r1")
            assert hearing.of(r1), "renewed too late, but in place: it comes back by itself"


def test_two_routers_are_one_site_and_either_may_be_away(tmp_path):
    field = Field(tmp_path, routers=("a", "b"))
    b = field.start_router("b")  # the first of the clients' list is not there
    began = time.monotonic()
    with field.open("robot/r1") as r1, field.open("server") as server:
        assert time.monotonic() - began < BACK_S
        hearing = Hearing(server, "r1")
        assert hearing.of(r1)
        a = field.start_router("a")
        try:
            assert linked(b)
            found = {step.name: step for step in check(field.install("robot/r2"))}
            assert found["session a"].state is found["session b"].state is State.OK
            with field.open("robot/r2", only(field, "a")) as r2:
                of_r2 = Hearing(server, "r2")
                assert of_r2.of(r2), "said to router a, heard at router b"
            b.close()
            assert hearing.of(r1), "both have gone to a"
        finally:
            a.close()


def linked(router: zenoh.Session) -> bool:
    return wait_until(lambda: bool(list(router.info.routers_zid())), BACK_S)


def only(field: Field, name: str):
    """Connects to one of the routers."""

    def change(told):
        told["connect"]["endpoints"] = [field.router(name).endpoint]

    return change
