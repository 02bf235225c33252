"""Shared by all tests: a router of a test's own, on this machine, and which tests are slow."""

from pathlib import Path

import pytest

from fleetpose.protocol.transport import SessionSettings, free_port, open_session

HERE = Path(__file__).parent
SLOW_FIXTURES = {"own_router", "open_link", "network", "cluster", "engine", "fleet", "start"}
SLOW_NAMES = {"subprocess", "shared_data", "LocalFleet"}  # in a module that starts or needs much
MEASURED = set((HERE / "slow.txt").read_text().splitlines())


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Marks what `make test-fast` leaves out."""
    for item in items:
        if is_slow(item):
            item.add_marker("slow")


def is_slow(item: pytest.Item) -> bool:
    """Whether a test needs a network, processes or recordings, or was measured to take long."""
    assert isinstance(item, pytest.Function)
    file = item.path.relative_to(HERE).as_posix()
    return (
        file.startswith("integration/")
        or not SLOW_FIXTURES.isdisjoint(item.fixturenames)
        or not SLOW_NAMES.isdisjoint(vars(item.module))
        or not MEASURED.isdisjoint({file, f"{file}::{item.originalname}"})
    )


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
