"""Options of the commands that show the screen."""

from pathlib import Path
from typing import Annotated, Literal

import typer

Fps = Annotated[float, typer.Option(help="looks at the state per second", min=1, max=60)]
Threshold = Annotated[float, typer.Option(help="hide errors above it, metres", min=0.0001)]
KeysFile = Annotated[
    Path | None,
    typer.Option(
        help="TOML file of keys, see 'hmi-client keys'; default: keys.toml in the config folder",
        envvar="FLEETPOSE_HMI_KEYS",
    ),
]
LogFile = Annotated[Path | None, typer.Option(help="log file; default in the state folder")]
Theme = Annotated[
    Literal["auto", "dark", "light", "mono"],
    typer.Option(
        help="colours; auto: mono with NO_COLOR, light or dark by COLORFGBG, else dark",
        envvar="FLEETPOSE_HMI_THEME",
    ),
]
