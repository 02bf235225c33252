"""Shared by the tests of the robot's agent: a router, and who listens to it."""

import pytest

from protocol.transport import Link, SessionSettings, free_port, open_session


@pytest.fixture
def router():
    """The endpoint of a router of its own."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    session = open_session(SessionSettings(listen=(endpoint,)))
    yield endpoint
    session.close()


@pytest.fixture
def link(router):
    """A link to that router, as the server would have."""
    opened = Link(open_session(SessionSettings(connect=(router,), timeout_s=5)))
    yield opened
    opened.close()
