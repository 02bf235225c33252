"""Why a robot with certificates reaches no router, in its own words: zenoh says no more than that
it could not connect.
"""

import socket

import pytest

pytest.importorskip("cryptography", reason="certificates are made with it")

from fleetpose.protocol.errors import UnreachableError
from fleetpose.protocol.session.echo import clock_fault, fault_behind_tls
from fleetpose.protocol.transport import SessionSettings, free_port, open_session
from tests.integration.certificates import Authority
from tests.integration.test_watching_router import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A site whose router runs in this process."""
    made = Site(tmp_path_factory.mktemp("site"))
    session = open_session(SessionSettings(config_file=made.router))
    yield made
    session.close()


def said(config) -> str:
    with pytest.raises(UnreachableError) as refused:
        open_session(SessionSettings(config_file=config, timeout_s=0.1))
    return str(refused.value)


def elsewhere(site, endpoint):
    """The configuration of a robot that asks another endpoint."""
    config = site.configuration("robot/r2")
    config.write_text(config.read_text().replace(site.endpoint, endpoint))
    return config


def test_an_expired_certificate_is_named(site):
    assert "this machine's certificate has expired" in said(
        site.configuration("robot/late", days=-1)
    )


def test_a_certificate_of_another_site_is_named(site, tmp_path):
    other = Authority(tmp_path, "authority of another site")
    assert "is of another site" in said(site.configuration("robot/r9", authority=other))


def test_a_router_of_another_site_is_named(site, tmp_path):
    config = site.configuration("robot/r2")
    other = Authority(tmp_path, "authority of another site")
    config.write_text(config.read_text().replace(str(site.authority.file), str(other.file)))
    assert "it is a router of another site" in said(config)


def test_another_host_name_is_named(site):
    config = elsewhere(site, site.endpoint.replace("localhost", "127.0.0.1"))
    assert "its certificate is not for '127.0.0.1'" in said(config)


def test_nobody_there_and_no_tls_are_named(site):
    assert "nothing listens there" in said(elsewhere(site, f"tls/localhost:{free_port()}"))
    assert "there is no host" in said(elsewhere(site, "tls/no-such-host.invalid:7447"))
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        assert "accepts a connection but says nothing" in said(
            elsewhere(site, f"tls/localhost:{port}")
        )


def test_a_router_without_tls_is_named(site):
    endpoint = f"localhost:{free_port()}"
    with open_session(SessionSettings(listen=(f"tcp/{endpoint}",))):
        assert "a zenoh router that speaks no TLS" in said(elsewhere(site, f"tls/{endpoint}"))


def test_what_is_in_order_opens(site):
    open_session(SessionSettings(config_file=site.configuration("robot/r2"), timeout_s=5)).close()


def test_a_certificate_that_the_rules_do_not_know_is_named_and_one_that_they_know_is_not(site):
    said = fault_behind_tls(site.configuration("robot/stranger"))
    assert "rules do not know robot 'stranger' of site 'demo'" in said
    assert fault_behind_tls(site.configuration("health/desk")) == ""


def test_a_clock_that_is_off_is_named_and_how_far():
    day_s = 86400.0
    assert "1.0 days ahead of the router's" in clock_fault(1e9, 1e9 + day_s)
    assert "10 minutes behind the router's" in clock_fault(1e9, 1e9 - 600)
    assert clock_fault(1e9, 1e9 + 60) == clock_fault(None, 1e9) == ""
