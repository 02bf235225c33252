"""What `--help` of every command says, and that the shell completes all of them."""

import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest
import typer

from fleetpose.pose_server.settings import ServerSettings
from fleetpose.robot_agent.settings import RobotSettings
from fleetpose.ros_bridge.settings import BridgeSettings
from tests.documents import checked, commands_in
from tests.test_commands import PACKAGES

PROGRAMS = {
    name: typer.main.get_command(import_module(f"{package}.__main__").app)
    for name, package in PACKAGES.items()
}
COLUMNS = 80


def walk(command, parent):
    """Contexts of a command and of all below it."""
    context = type(parent)(command, info_name=command.name, parent=parent)
    yield context
    for below in getattr(command, "commands", {}).values():
        yield from walk(below, context)


def contexts():
    for name, program in PROGRAMS.items():
        root = program.context_class(program, info_name=name)
        yield root
        for below in program.commands.values():
            if not below.hidden:
                yield from walk(below, root)


ALL = {context.command_path: context for context in contexts()}
LEAVES = {path: one for path, one in ALL.items() if not getattr(one.command, "commands", None)}


def help_of(context) -> str:
    """As at 80 columns."""
    context.terminal_width = COLUMNS
    return context.command.get_help(context)


@pytest.mark.parametrize("path", ALL)
def test_help_fits_80_columns_and_cuts_nothing(path):
    lines = help_of(ALL[path]).splitlines()
    assert [line for line in lines if len(line) > COLUMNS] == []
    told = "\n".join(line for line in lines if "Usage:" not in line)
    for placeholder in ("[ARGS]...", "NAME...", "}..."):
        told = told.replace(placeholder, "")
    cut = [line for line in told.splitlines() if line.rstrip().endswith(("...", "…"))]
    assert cut == []


@pytest.mark.parametrize("path", ALL)
def test_every_option_says_what_it_means_and_its_default(path):
    context = ALL[path]
    for one in context.command.params:
        if one.param_type_name != "option" or one.hidden:
            continue
        told = " ".join(one.get_help_record(context))
        assert one.help, f"{path} {one.opts[0]}"
        shown = one.default not in (None, "", (), []) and not one.is_flag
        if shown and not one.required:
            assert "[default: " in told, (path, one.opts, one.default)


@pytest.mark.parametrize("path", LEAVES)
def test_every_command_has_an_example_that_its_program_takes(path):
    help = help_of(LEAVES[path]).replace("\\\n", "")
    assert "Example" in help, path
    shown = commands_in("    " + help.partition("Example")[2].replace("\n", "\n    "), PROGRAMS)
    assert shown
    for example in shown:
        assert str(example).startswith(path), example
        checked(example, PROGRAMS[example.words[0]])


@pytest.mark.parametrize(
    ("path", "settings"),
    [
        ("robot-agent run", RobotSettings),
        ("pose-server run", ServerSettings),
        ("pose-ros bridge", BridgeSettings),
    ],
)
def test_options_of_settings_name_their_choices_and_defaults(path, settings):
    context = ALL[path]
    told = {one.name: "".join(one.get_help_record(context)) for one in context.command.params[:-1]}
    for name, field in settings.model_fields.items():
        if get_origin(field.annotation) is Literal:
            assert f"<{'|'.join(get_args(field.annotation))}>" in told[name]
        default = field.get_default(call_default_factory=True)
        if field.is_required():
            assert "[required]" in told[name]
        elif isinstance(default, int | float | Path) and not isinstance(default, bool):
            assert f"[default: {default}]" in told[name]


def completed(program: str, folder: Path, *words: str) -> list[str]:
    """What bash is offered for the last word."""
    asked = {
        f"_{program.replace('-', '_')}_COMPLETE".upper(): "complete_bash",
        "COMP_WORDS": " ".join((program, *words)),
        "COMP_CWORD": str(len(words)),
    }
    code = f"from {PACKAGES[program]}.__main__ import main; main()"
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        env=os.environ | asked,
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
    )
    return done.stdout.split()


@pytest.mark.parametrize("program", PROGRAMS)
def test_a_shell_completes_commands_and_options(program, tmp_path):
    command = next(name for name, one in PROGRAMS[program].commands.items() if not one.hidden)
    assert command in completed(program, tmp_path, command[:2])
    assert "--help" in completed(program, tmp_path, command, "--h")
    assert "--show-completion" in help_of(ALL[program])


def test_a_shell_completes_values_of_settings(tmp_path):
    assert completed("robot-agent", tmp_path, "run", "--replay", "p") == ["pingpong"]
