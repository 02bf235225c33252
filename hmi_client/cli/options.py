"""Options of the commands that show the screen, and of all."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from fleetpose.hmi_client.settings import as_defaults


def given_before(context: typer.Context, parameter: typer.CallbackParam, value: Any) -> Any:
    """An option that was given before the command counts for it, unless it is given again behind:
    `hmi-client --connect ENDPOINT why r7`.
    """
    name, here = parameter.name or "", context
    while not _is_written(here, name):
        if here.parent is None:
            return value
        here = here.parent
    return value if here is context else here.params[name]


class Given(str):
    """A text that somebody gave, be it the default's."""


def given_site(context: typer.Context, parameter: typer.CallbackParam, value: str) -> str:
    """The same, and tells a site that was given from the default."""
    here, name = context, parameter.name or ""
    while here is not None:
        source: Any = here.get_parameter_source(name)
        if source is not None and source.name != "DEFAULT":
            return Given(given_before(context, parameter, value))
        here = here.parent
    return value


def _is_written(context: Any, name: str) -> bool:
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"  # typer has had two homes for it


SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        help="settings file (TOML), as --dump-settings prints it",
        is_eager=True,
        callback=as_defaults,
    ),
]
Fps = Annotated[
    float,
    typer.Option(help="looks at the state per second", min=1, max=60, callback=given_before),
]
Threshold = Annotated[
    float | None,
    typer.Option(
        help="hide errors above it, metres [default: a tenth of the scene's depth]",
        min=0.0001,
        callback=given_before,
    ),
]
KeysFile = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        help="TOML file of keys, see 'hmi-client keys' [default: keys.toml in the config folder]",
        callback=given_before,
    ),
]
LogFile = Annotated[
    Path | None,
    typer.Option(help="log file [default: in the state folder]", callback=given_before),
]
OpenBrowser = Annotated[bool, typer.Option("--open/--no-open", help="show the page in the browser")]
Theme = Annotated[
    Literal["auto", "dark", "light", "mono"],
    typer.Option(
        help="colours; auto: mono with NO_COLOR, light or dark by COLORFGBG, else dark",
        callback=given_before,
    ),
]
