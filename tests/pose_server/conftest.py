"""A worker's views are cached by name: tests that run jobs here use the same names for others."""

import pytest

from pose_server.pairs import engine


@pytest.fixture(autouse=True)
def no_views_of_another_test():
    engine._prepared.clear()
    yield
    engine._prepared.clear()  # a module's own fixtures are made before this one
