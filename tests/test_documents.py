"""What documents say holds: links lead somewhere, commands and options exist, Python runs as far as
its names go, and the first pages stay short.
"""

import ast
import re
from importlib import import_module
from pathlib import Path

import pytest
import typer

from fleetpose.protocol.keys import Keys
from fleetpose.protocol.messages import MESSAGES
from tests.documents import (
    Command,
    WrongCommandError,
    checked,
    commands_in,
    flags_of,
    headings_of,
    links_in,
    options_in,
    python_in,
    spans_in,
)

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted(
    [
        *(ROOT / name for name in ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md")),
        *(ROOT / "docs").rglob("*.md"),
    ]
)
APPS = {
    "robot-agent": "robot_agent.__main__",
    "pose-server": "pose_server.__main__",
    "hmi-client": "hmi_client.cli.commands",
    "pose-eval": "evaluation.__main__",
    "pose-deploy": "deploy.__main__",
    "pose-ros": "ros_bridge.__main__",
}
MOST_WORDS, MOST_LINES = 800, 90
FOLDERS = (
    *("formats", "protocol", "rosmsg", "robot_agent", "pose_server", "hmi_client", "evaluation"),
    *("deploy", "ros_bridge"),
    *("scripts", "tests"),
)

each_document = pytest.mark.parametrize(
    "document", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT))
)


@pytest.fixture(scope="module")
def apps():
    modules = {name: import_module(f"fleetpose.{module}") for name, module in APPS.items()}
    return {name: typer.main.get_command(module.app) for name, module in modules.items()}


@each_document
def test_links_and_pictures_lead_somewhere(document):
    missing = [
        target
        for target, anchor in links_in(document.read_text())
        if not (there := document.parent / target if target else document).exists()
        or (anchor and anchor not in headings_of(there.read_text()))
    ]
    assert not missing


@each_document
def test_commands_and_their_options_exist(document, apps):
    for command in commands_in(document.read_text(), apps):
        checked(command, apps[command.words[0]])


@each_document
def test_options_that_stand_alone_are_options_of_some_command(document, apps):
    known = set().union(*map(flags_of, apps.values()))
    assert not set(options_in(document.read_text())) - known


@each_document
def test_files_that_are_named_exist(document):
    """`pose_server/pipeline.py`, and `registration/align.py` or `align.py` of one of the rooms."""
    named = {span for span in spans_in(document.read_text()) if re.fullmatch(r"[\w/]+\.py", span)}
    there = {path.as_posix() for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    assert not {name for name in named if not any(path.endswith(f"/{name}") for path in there)}


@each_document
def test_targets_of_make_exist(document):
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.M))
    words = [span.split() for span in spans_in(document.read_text())]
    assert not {one[1] for one in words if one[0] == "make" and len(one) > 1} - targets


@each_document
def test_python_compiles_and_imports_what_there_is(document):
    for block in python_in(document.read_text()):
        for node in ast.walk(ast.parse(block)):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fleetpose"):
                module = import_module(node.module or "")
                assert all(hasattr(module, name.name) for name in node.names), block


def test_the_first_pages_stay_short():
    assert len((ROOT / "ARCHITECTURE.md").read_text().split()) <= MOST_WORDS
    assert len((ROOT / "README.md").read_text().splitlines()) <= MOST_LINES


def test_the_readme_shows_python_and_all_three_processes(apps):
    text = (ROOT / "README.md").read_text()
    assert "from fleetpose import" in "".join(python_in(text))
    assert {command.words[0] for command in commands_in(text, apps)} >= set(list(APPS)[:3])


def test_the_wire_page_has_every_message_and_every_key():
    text = (ROOT / "docs/wire.md").read_text()
    for message in MESSAGES:
        assert f"| `{message.__name__}` | `{message.schema_name}` |" in text
    keys = Keys()
    for key in (
        *(keys.camera("<id>"), keys.cloud("<id>"), keys.image("<id>"), keys.odometry("<id>")),
        *(keys.view("<id>"), keys.robot_alive("<id>", "<epoch>"), keys.pose("<id>")),
        *(keys.alignment("<i>", "<j>"), keys.correspondences("<i>", "<j>")),
        *(keys.updates("<op>"), keys.receipts("<op>"), keys.selection("<op>")),
        *(keys.state, keys.status, keys.relative, keys.why, keys.server_view),
        keys.server_alive("<epoch>"),
    ):
        assert f"| `{key.removeprefix(keys.root + '/')}" in text


def test_the_documents_name_every_program(apps):
    named = {
        command.words[0] for path in DOCUMENTS for command in commands_in(path.read_text(), apps)
    }
    assert named == set(apps)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("pose-server runs", "'runs'"),
        ("pose-server run --anchr r1", "'--anchr'"),
        ("pose-eval fleet --icp gicp", "'--icp'"),
        ("pose-eval --data DIR", "'--data'"),
        ("hmi-client correspondences ad r1 r2", "'ad'"),
        ("robot-agent run --name", "needs a value"),
        ("pose-eval wire DIR", "'DIR'"),
    ],
)
def test_a_wrong_command_line_is_named(apps, line, said):
    for text in (f"Run `{line}` now.", f"    {line}  # a comment", f"```sh\n{line}\n```"):
        (command,) = commands_in(text, apps)
        with pytest.raises(WrongCommandError, match=re.escape(said)):
            checked(command, apps[command.words[0]])


@pytest.mark.parametrize(
    "line",
    [
        "hmi-client --connect tcp/10.0.0.1:7447 why r7",
        "robot-agent run --connect tcp/10.0.0.1:7447 --name r1 --camera rgbd ...",
        "pose-server run --dump-settings > server.toml",
        "pose-eval pairs --data=DIR --without-images",
        "pose-server export --state-dir fleetpose-state --map map.ply",
    ],
)
def test_a_right_command_line_passes(apps, line):
    (command,) = commands_in(f"    {line}\n", apps)
    checked(command, apps[command.words[0]])


def test_a_command_may_be_broken_over_two_lines_of_a_paragraph(apps):
    assert commands_in("as `pose-eval\npairs` does", apps) == [Command(("pose-eval", "pairs"))]


def test_a_link_that_leads_nowhere_would_be_found():
    text = "[a](b.md#c-d) ![p](q.png) [w](https://x.org) `[no](link)`\n\n    [nor](this)\n"
    assert links_in(text) == [("b.md", "c-d"), ("q.png", "")]
    assert headings_of("# A b\n## C `d`: e\n") == {"a-b", "c-d-e"}
