"""What the commands of all processes share: their help, their version, and how they end.

What a user can mend is one sentence and an exit code; anything else is a bug with its traceback.
"""

import sys
from importlib.util import find_spec
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from fleetpose.protocol.errors import FleetPoseError, UnreachableError
from fleetpose.protocol.text import release

REFUSED = 2  # exit code of bad input and of what is not installed
MODULES = {  # that an extra brings, as they are imported; Open3D is done without where it fails
    "robot": ("cv2", "yaml"),
    "server": (
        *("scipy", "gtsam", "small_gicp", "kiss_matcher"),
        *("threadpoolctl", "numba", "matplotlib"),
    ),
    "cluster": ("distributed",),
    "metrics": ("prometheus_client",),
    "record": ("mcap", "foxglove_schemas_protobuf", "mcap_protobuf"),
    "live": ("foxglove",),
    "hmi": ("cv2", "textual", "rich", "mcap"),
    "web": ("starlette", "uvicorn", "websockets"),
    "rerun": ("rerun",),
    "ros": ("rosbags", "mcap", "xxhash"),
    "deploy": ("cryptography",),
    "eval": ("psutil", "DracoPy"),
}
PARTS = {"eval": ("robot", "server", "hmi"), "web": ("hmi",)}  # extras that an extra brings


class Group(TyperGroup):
    """Commands, each listed with its whole first sentence: nothing is cut at 80 columns."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Writes the list of commands; the types are those of typer's own click."""
        commands = {name: self.get_command(ctx, name) for name in self.list_commands(ctx)}
        rows = [
            (name, command.get_short_help_str(sys.maxsize))
            for name, command in commands.items()
            if command is not None and not command.hidden
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


def command_line(no_args_is_help: bool = True) -> typer.Typer:
    """The commands of a program: help in plain text, as every terminal and pager shows it, and
    completion by the shell; a bug's traceback stays as it is.
    """
    return typer.Typer(
        cls=Group,
        no_args_is_help=no_args_is_help,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )


def examples(*lines: str) -> str:
    """Command lines as the end of a command's help; none is wrapped."""
    head = "Example:" if len(lines) == 1 else "Examples:"
    return "\n".join(("\b", head, *(f"  {line}" for line in lines)))


def run_command(app: typer.Typer, name: str, extras: str, unreachable: int = REFUSED) -> None:
    """Runs a command line, and ends the process as it went.

    Args:
        app: the command.
        name: as its user calls it.
        extras: what it needs installed, with commas between.
        unreachable: exit code where no router, robot or server answers.
    """
    try:
        app(prog_name=name)
    except UnreachableError as error:
        _end(name, str(error), unreachable)
    except FleetPoseError as error:
        _end(name, str(error), REFUSED)
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        extra = _extra_with(module, extras)
        if extra is None:
            raise
        _end(name, f"'{module}' is not installed: pip install 'fleetpose[{extra}]'", REFUSED)


def require(extras: str) -> None:
    """Looks for what extras bring, for processes whose children import it.

    Raises:
        ModuleNotFoundError: something is not installed.
    """
    for module in _modules_of(extras):
        if find_spec(module) is None:
            raise ModuleNotFoundError(f"No module named '{module}'", name=module)


def _modules_of(extras: str) -> list[str]:
    names = [part for extra in extras.split(",") for part in (*PARTS.get(extra, ()), extra)]
    return [module for name in names for module in MODULES[name]]


def _extra_with(module: str, extras: str) -> str | None:
    """The command's own extras if they bring the module, else the first that does."""
    candidates = (extras, *MODULES)
    return next((extra for extra in candidates if module in _modules_of(extra)), None)


def _end(name: str, sentence: str, code: int) -> None:
    print(f"{name}: {sentence}", file=sys.stderr)
    sys.exit(code)


def _print_version(context: typer.Context, asked: bool) -> None:
    if asked:
        typer.echo(f"{context.find_root().info_name} {release()}")
        raise typer.Exit


Version = Annotated[
    bool,
    typer.Option(
        "--version", help="Print the version and end.", is_eager=True, callback=_print_version
    ),
]
