"""A session opens whichever of its routers is there, and whoever waits for one says so."""

import json
import logging
import socket
import threading
import time
from contextlib import ExitStack, contextmanager

import pytest

from fleetpose.protocol.errors import EndedError, EndpointError, UnreachableError
from fleetpose.protocol.transport import (
    Link,
    SessionSettings,
    free_port,
    open_session,
    wait_until,
)

SOON_S = 20.0  # one try takes a second
ROUTER_ONLY = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}


def dead_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@contextmanager
def silent_endpoint(full: bool):
    """One that takes connections and says nothing; `full`: its packets are swallowed."""
    with ExitStack() as opened:
        listener = opened.enter_context(socket.socket())
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(4 if full else 0):
            waiting = opened.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(listener.getsockname())
        yield f"tcp/127.0.0.1:{listener.getsockname()[1]}"


@pytest.fixture(params=["flags", "file"])
def settings_of(request, tmp_path):
    """Settings for endpoints: `settings_of(endpoints, **more)`, in both ways of opening."""

    def make(*endpoints: str, **more) -> SessionSettings:
        if request.param == "flags":
            return SessionSettings(connect=endpoints, **more)
        file = tmp_path / "zenoh.json5"
        config = {
            "mode": "client",
            "scouting": ROUTER_ONLY,
            "connect": {"endpoints": list(endpoints), "timeout_ms": 10_000},
        }
        file.write_text(json.dumps(config))
        return SessionSettings(config_file=file, **more)

    return make


def opened_within_s(settings: SessionSettings) -> float:
    began_s = time.monotonic()
    link = Link(open_session(settings))
    took_s = time.monotonic() - began_s
    try:
        assert wait_until(lambda: link.connected, 30)
    finally:
        link.close()
    return took_s


def test_it_opens_though_the_first_router_is_dead(router, settings_of):
    assert opened_within_s(settings_of(dead_endpoint(), router)) < SOON_S


@pytest.mark.parametrize("full", [False, True], ids=["says nothing", "swallows packets"])
def test_it_opens_though_the_first_router_does_not_answer(router, settings_of, full):
    with silent_endpoint(full) as silent:
        took_s = opened_within_s(settings_of(silent, router))
    assert 1.0 < took_s < SOON_S


def test_a_start_waits_for_its_router_and_says_for_which(own_router, settings_of, caplog):
    caplog.set_level(logging.INFO)
    own_router.close()
    opened: list[Link] = []
    settings = settings_of(own_router.endpoint, timeout_s=-1)
    starting = threading.Thread(target=lambda: opened.append(Link(open_session(settings))))
    starting.start()
    said = f"no zenoh router at {own_router.endpoint}"
    assert wait_until(lambda: said in caplog.text, 30)
    own_router.start()
    starting.join(5)
    assert opened and opened[0].connected
    opened[0].close()
    warnings = [one for one in caplog.records if one.levelno == logging.WARNING]
    assert len(warnings) == 1 and "waiting for it" in warnings[0].message
    assert "router reached after" in caplog.text


def test_the_waiting_can_be_ended(settings_of):
    stop = threading.Event()
    threading.Timer(0.3, stop.set).start()
    with pytest.raises(EndedError, match="waiting for a router"):
        open_session(settings_of(dead_endpoint(), timeout_s=-1, stop=stop))


def test_a_bounded_wait_ends_with_the_address(settings_of):
    endpoint = dead_endpoint()
    with pytest.raises(UnreachableError, match=endpoint):
        open_session(settings_of(endpoint, timeout_s=0.3))


def test_a_link_that_was_lost_comes_back(own_router, settings_of):
    link = Link(open_session(settings_of(dead_endpoint(), own_router.endpoint)))
    try:
        own_router.close()
        assert wait_until(lambda: not link.connected, 30)
        own_router.start()
        assert wait_until(lambda: link.connected, 30)
    finally:
        link.close()


def test_an_address_that_is_taken_is_no_missing_router():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(EndpointError, match=f"no router can be at {endpoint}.*in use"):
            open_session(SessionSettings(listen=(endpoint,)))


@pytest.mark.parametrize("listens", [False, True])
def test_a_router_that_is_not_there_is_told_apart_from_another_program(listens):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        if listens:
            other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(UnreachableError) as refused:
            open_session(SessionSettings(connect=(endpoint,), timeout_s=0.1))
    why = "what listens there is no zenoh router" if listens else "nothing listens there"
    assert str(refused.value).startswith(f"no zenoh router at {endpoint}: {why}")
    assert "/root/" not in str(refused.value)


def test_a_host_that_is_not_known_is_named():
    with pytest.raises(UnreachableError, match=r"there is no host 'nobody\.invalid'"):
        open_session(SessionSettings(connect=("tcp/nobody.invalid:7447",), timeout_s=0.1))


def test_a_certificate_that_cannot_be_read_is_named_before_anything_is_opened(tmp_path):
    file = tmp_path / "zenoh.json5"
    missing = tmp_path / "ca.pem"
    tls = {"root_ca_certificate": str(missing)}
    endpoint = "tls/127.0.0.1:1"
    file.write_text(
        json.dumps(
            {
                "mode": "client",
                "connect": {"endpoints": [endpoint]},
                "transport": {"link": {"tls": tls}},
            }
        )
    )
    with pytest.raises(EndpointError, match=f"{missing} cannot be read: No such file"):
        open_session(SessionSettings(config_file=file, timeout_s=-1))
