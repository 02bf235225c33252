"""Settings of the operator's client; in the environment `FLEETPOSE_HMI_SITE` and so on."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import click
from pydantic import Field
from pydantic_settings import SettingsConfigDict

from fleetpose.protocol.keys import checked_name
from fleetpose.protocol.settings import Endpoints, ProcessSettings, checked_text


def _checked_sites(text: str) -> str:
    for name in text.split(","):
        checked_name(name.strip())
    return text


Sites = Annotated[str, checked_text(_checked_sites)]


class ClientSettings(ProcessSettings):
    """What a settings file of `hmi-client` may hold."""

    model_config = SettingsConfigDict(env_prefix="FLEETPOSE_HMI_")
    roles: ClassVar[tuple[str, ...]] = ("operator", "observer")
    identified: ClassVar[Mapping[str, str]] = {"site": "site", "name": "operator"}

    connect: Endpoints = Field(("tcp/127.0.0.1:7447",), description="endpoints of the router")
    site: Sites = Field("demo", description="name of the site, or of several: a,b")
    config: Path | None = Field(None, description="zenoh configuration (JSON5), replaces connect")
    operator: str = Field("", description="who you are; empty: the user's name")
    fps: float = Field(10.0, ge=1, le=60, description="looks at the state per second")
    threshold: float | None = Field(
        None, ge=0.0001, description="hide errors above it, metres; if not set, by the depth"
    )
    theme: Literal["auto", "dark", "light", "mono"] = Field("auto", description="colours")
    keys: Path | None = Field(None, description="file of keys, see 'hmi-client keys'")
    log: Path | None = Field(None, description="log file; if not set, in the state folder")


def as_defaults(context: click.Context, parameter: Any, file: Path | None) -> Path | None:
    """Makes the file's settings the defaults of all commands; those of the environment and the
    command line go before them.

    Raises:
        SettingsRefusedError: a setting in the file or in the environment is unknown or impossible.
    """
    loaded = ClientSettings.load(file, {})
    given = {name: getattr(loaded, name) for name in loaded.model_fields_set}
    if "connect" in given:
        given["connect"] = list(given["connect"])
    if "keys" in given:
        given["keys_file"] = given.pop("keys")  # `keys` is a command
    context.default_map = _for_all(context.command, given)
    return file


def _for_all(command: click.Command, given: dict[str, Any]) -> dict[str, Any]:
    below = getattr(command, "commands", {})
    return given | {name: _for_all(one, given) for name, one in below.items()}
