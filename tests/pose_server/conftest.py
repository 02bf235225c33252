"""A worker's views are cached by name: tests that run jobs here use the same names for others."""

import pytest

from fleetpose.pose_server.workers import run


@pytest.fixture(autouse=True)
def no_views_of_another_test():
    run._prepared.clear()
    yield
    run._prepared.clear()  # a module's own fixtures are made before this one
