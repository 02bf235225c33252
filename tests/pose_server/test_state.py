"""Every store of what the server holds is written by its own methods alone, so that whoever asks
how a value came about has one file to read.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import fleetpose.pose_server

SERVER = Path(fleetpose.pose_server.__file__).parent
STORES = (*(SERVER / "state").glob("*.py"), SERVER / "frontend" / "tracks.py")
CHANGES = {
    *("add", "append", "appendleft", "clear", "difference_update", "discard", "extend", "insert"),
    *("move_to_end", "pop", "popitem", "popleft", "remove", "setdefault", "sort", "update"),
}
CONTAINERS = {"Counter", "OrderedDict", "defaultdict", "deque", "dict", "list", "set"}


def test_fields_of_the_state_are_written_by_its_own_methods_alone():
    stores = [ast.parse(path.read_text()) for path in STORES]
    fields = {name: kind for tree in stores for name, kind in fields_of(tree)}
    assert {"solution", "status", "newest", "keyframes", "answers"} <= set(fields)
    found = [
        f"{path.relative_to(SERVER)}:{line}: {text}"
        for path in sorted(SERVER.rglob("*.py"))
        if path not in STORES
        for line, text in writes(ast.parse(path.read_text()), fields)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize(
    "line",
    [
        "site.solution = None",
        "site.robots[name].newest = view",
        "record.best, other = result, 1",
        "site.gauge_revision += 1",
        "del site.robots[name]",
        "site.pairs[pair] = record",
        "robot.track.keyframes.append(view)",
        "site.views_held.pop(name)",
    ],
)
def test_a_write_from_elsewhere_is_found(line):
    fields = dict.fromkeys(("solution", "newest", "best", "gauge_revision"), "X | None")
    fields |= dict.fromkeys(("robots", "pairs", "keyframes", "views_held"), "dict[str, X]")
    assert len(list(writes(ast.parse(line), fields))) == 1


@pytest.mark.parametrize(
    "line", ["x = site.solution", "self.solution = 1", "site.solution.update()"]
)
def test_reading_and_calling_is_no_write(line):
    assert not list(writes(ast.parse(line), {"solution": "FleetSolution | None"}))


def fields_of(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """The fields of the classes that can be written, and their types."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not is_frozen(node):
            for line in node.body:
                if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name):
                    yield line.target.id, ast.unparse(line.annotation)


def is_frozen(node: ast.ClassDef) -> bool:
    return any("frozen=True" in ast.unparse(decorator) for decorator in node.decorator_list)


def writes(tree: ast.AST, fields: dict[str, str]) -> Iterator[tuple[int, str]]:
    """Assignments to, and changes of, a field of something else than `self`."""
    for node in ast.walk(tree):
        targets: list[ast.expr] = []
        if isinstance(node, ast.Assign | ast.Delete):
            targets = list(node.targets)
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            targets = [node.func.value] if is_change(node.func, fields) else []
        for target in targets:
            for part in target.elts if isinstance(target, ast.Tuple) else [target]:
                while isinstance(part, ast.Subscript):
                    part = part.value
                if isinstance(part, ast.Attribute) and part.attr in fields and not is_own(part):
                    yield node.lineno, ast.unparse(node)


def is_change(called: ast.Attribute, fields: dict[str, str]) -> bool:
    """Whether a method changes a container that a field holds."""
    held = called.value
    while isinstance(held, ast.Subscript):
        held = held.value
    kind = fields.get(held.attr, "") if isinstance(held, ast.Attribute) else ""
    return called.attr in CHANGES and kind.split("[")[0] in CONTAINERS


def is_own(part: ast.Attribute) -> bool:
    return isinstance(part.value, ast.Name) and part.value.id == "self"
