"""What the commands of all processes share: their version, and how they end.

What a user can mend is one sentence and an exit code; anything else is a bug with its traceback.
"""

import sys
from importlib.util import find_spec
from typing import Annotated

import typer

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
