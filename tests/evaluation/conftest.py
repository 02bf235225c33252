"""Shared by the tests of the evaluation: a router of their own and links to it."""

import pytest

from fleetpose.protocol.transport import Link, SessionSettings, free_port, open_session


@pytest.fixture
def open_link():
    """Opens links to a router that lives as long as the test."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = open_session(SessionSettings(listen=(endpoint,)))
    links: list[Link] = []

    def connect() -> Link:
        links.append(Link(open_session(SessionSettings(connect=(endpoint,), timeout_s=5))))
        return links[-1]

    yield connect
    for link in links:
        link.close()
    router.close()
