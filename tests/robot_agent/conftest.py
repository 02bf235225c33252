"""Shared by the tests of the robot's agent: who listens to its router."""

import pytest

from fleetpose.protocol.transport import Link, SessionSettings, open_session


@pytest.fixture
def link(router):
    """A link to that router, as the server would have."""
    opened = Link(open_session(SessionSettings(connect=(router,), timeout_s=5)))
    yield opened
    opened.close()
