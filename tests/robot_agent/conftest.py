"""Shared by the tests of the robot's agent: a router, and who listens to it."""

import pytest

from protocol.transport import Link, SessionSettings, free_port, open_session


class Router:
    """A router that can be ended and started again at the same endpoint."""

    def __init__(self) -> None:
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.start()

    def start(self) -> None:
        self._session = open_session(SessionSettings(listen=(self.endpoint,)))

    def close(self) -> None:
        self._session.close()


@pytest.fixture
def own_router():
    """A router of its own that the test may restart."""
    started = Router()
    yield started
    started.close()


@pytest.fixture
def router(own_router):
    """The endpoint of a router of its own."""
    return own_router.endpoint


@pytest.fixture
def link(router):
    """A link to that router, as the server would have."""
    opened = Link(open_session(SessionSettings(connect=(router,), timeout_s=5)))
    yield opened
    opened.close()
