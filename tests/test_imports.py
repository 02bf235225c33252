"""No file imports itself by way of others, wherever in a file the import stands."""

import ast
import tomllib
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
MOST_IN_A_FOLDER = 12


def folders() -> dict[str, Path]:
    """The folders of the repository by the names under which they are installed."""
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    return {name: ROOT / folder for name, folder in setup["package-dir"].items()}


def files() -> dict[str, Path]:
    return {
        ".".join((name, *path.relative_to(folder).with_suffix("").parts)).removesuffix(
            ".__init__"
        ): path
        for name, folder in folders().items()
        for path in folder.rglob("*.py")
    }


def imports() -> dict[str, set[str]]:
    """What each module imports of the others; a name of a package is that package's, or a module's
    of its own.
    """
    modules = files()
    found: dict[str, set[str]] = {name: set() for name in modules}
    for name, path in modules.items():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module in modules:
                of = {f"{node.module}.{alias.name}" for alias in node.names}
                found[name] |= {one if one in modules else node.module for one in of}
            elif isinstance(node, ast.Import):
                found[name] |= {alias.name for alias in node.names if alias.name in modules}
    return found


def test_no_module_imports_itself_by_way_of_others():
    TopologicalSorter(imports()).prepare()


def test_a_circle_would_be_found():
    found = imports()
    found["fleetpose.pose_server.state.site"].add("fleetpose.pose_server.pipeline")
    with pytest.raises(CycleError):
        TopologicalSorter(found).prepare()


def test_no_folder_is_too_full_to_be_looked_through():
    full = {
        str(folder.relative_to(ROOT)): count
        for top in folders().values()
        for folder in [top, *(path for path in top.rglob("*") if path.is_dir())]
        if (count := sum(not p.name.startswith("__") for p in folder.glob("*.py")))
        > MOST_IN_A_FOLDER
    }
    assert not full
