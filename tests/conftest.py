"""Shared by all tests: a router of a test's own, on this machine."""

import pytest

from fleetpose.protocol.transport import SessionSettings, free_port, open_session


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
