"""Numbers of registration and geometry have a home: fitted ones are fields of a settings object,
others say beside them where they are from.
"""

import ast
from pathlib import Path

import pytest

import fleetpose.pose_server
from fleetpose.pose_server.registration.verdict.words import WORDS, needed_matches
from fleetpose.pose_server.tuned import replace_in_use, tuned

SERVER = Path(fleetpose.pose_server.__file__).parent
ORIGINS = ("# derived:", "# cited:", "# numerical:", "# compiled:", "# an order")


def numbers(source: str) -> list[str]:
    """Module-level numbers that do not say where they are from."""
    lines = source.splitlines()
    return [
        lines[node.lineno - 1]
        for node in ast.parse(source).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        and node.value is not None
        and not isinstance(node.value, ast.Call)
        and any(is_number(part) for part in ast.walk(node.value))
        and not any(origin in lines[(node.end_lineno or 0) - 1] for origin in ORIGINS)
    ]


def is_number(part: ast.AST) -> bool:
    return isinstance(part, ast.Constant) and type(part.value) in (int, float)


@pytest.mark.parametrize("folder", ["registration", "geometry"])
def test_every_number_says_where_it_is_from(folder):
    for path in (SERVER / folder).rglob("*.py"):
        assert not numbers(path.read_text()), path


def test_a_number_without_a_home_is_found():
    assert numbers("_A, _B = 0.5, 3  # of something") == ["_A, _B = 0.5, 3  # of something"]
    assert not numbers("_A = 9.0  # derived: three sigmas squared\n_B = A(1)")


def test_another_number_is_gone_by():
    before = needed_matches(1000)
    try:
        replace_in_use("words.needed_matches", 30)
        assert needed_matches(1000) == before + 20 and tuned()["words.needed_matches"] == 30
    finally:
        replace_in_use("words.needed_matches", before - 10)
    assert WORDS.needed_matches == 10
    with pytest.raises(KeyError):
        replace_in_use("words.nothing", 1)
