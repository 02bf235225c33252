"""What a robot gets installed: the closure of the extra `robot` in what is installed here."""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
import yaml

HEAVY = {"open3d", "gtsam", "small-gicp", "kiss-matcher", "textual", "scipy", "matplotlib"}
NEEDED = {"numpy", "eclipse-zenoh", "msgpack", "zstandard", "pydantic", "typer"}


def closure(package: str, extras: frozenset[str]) -> set[str]:
    """Names of all packages that `pip install package[extras]` brings, itself left out."""
    found: set[str] = set()
    left = [(package, extras)]
    seen = set(left)
    while left:
        name, wanted = left.pop()
        for requirement in requirements_of(name):
            match = re.match(r"([A-Za-z0-9._-]+)(?:\[([^\]]*)\])?[^;]*(?:;(.*))?$", requirement)
            assert match, requirement
            needed_for = set(re.findall(r"extra == ['\"]([^'\"]+)['\"]", match[3] or ""))
            if needed_for and not needed_for & wanted:
                continue
            child = re.sub(r"[._]+", "-", match[1]).lower()
            step = (child, frozenset(filter(None, (match[2] or "").replace(" ", "").split(","))))
            found |= {child} - {package}
            if step not in seen:
                seen.add(step)
                left.append(step)
    return found


def requirements_of(name: str) -> list[str]:
    try:
        return requires(name) or []
    except PackageNotFoundError:  # for another platform or Python
        return []


def test_a_robot_gets_what_it_needs_and_nothing_of_server_and_screen():
    robot = closure("fleetpose", frozenset({"robot"}))
    assert robot >= NEEDED | {"opencv-python-headless"}
    assert not robot & HEAVY


@pytest.mark.parametrize(("extra", "brings"), [("server", "gtsam"), ("hmi", "textual")])
def test_the_closure_is_found_at_all(extra, brings):
    assert brings in closure("fleetpose", frozenset({extra}))


def test_every_package_of_the_project_is_installed():
    root = Path(__file__).parent.parent
    told = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = told["package-dir"]
    there = {
        ".".join((name, *init.parent.relative_to(root / folder).parts))
        for name, folder in folders.items()
        for init in (root / folder).rglob("__init__.py")
    }
    assert set(told["packages"]) == there


def test_package_changelog_and_citation_tell_one_version():
    root = Path(__file__).parent.parent
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    [newest, *_] = re.findall(
        r"^## ([\d.]+) - ([\d-]+)$", (root / "CHANGELOG.md").read_text(), re.M
    )
    cited = yaml.safe_load((root / "CITATION.cff").read_text())
    assert (version, str(cited["date-released"])) == newest
    assert cited["version"] == version
