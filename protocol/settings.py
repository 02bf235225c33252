"""Settings of a process: defaults, overlaid by a TOML file, the environment and the command line.

A process has one class of settings. Its fields are the options of its command line, the names in
its file and, in capitals behind the prefix, the variables of the environment.
"""

import difflib
import inspect
import json
import os
import re
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Self, TypeVar, Union, get_args, get_origin

import typer
from pydantic import AfterValidator, BeforeValidator, ValidationError, model_validator
from pydantic.fields import FieldInfo
from pydantic_settings import (
    BaseSettings,
    NoDecode,
    PydanticBaseSettingsSource,
    SettingsConfigDict,
    SettingsError,
    TomlConfigSettingsSource,
)

from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.keys import checked_endpoint, checked_name

F = TypeVar("F", bound=Callable[..., Any])
PREFIXES = ("FLEETPOSE_ROBOT_", "FLEETPOSE_SERVER_", "FLEETPOSE_HMI_", "FLEETPOSE_BRIDGE_")
_file: ContextVar[Path | None] = ContextVar("file", default=None)  # that is read at present
_CLOSE = 0.75  # of a misspelt name to the one that was meant, as difflib counts


class SettingsRefusedError(FleetPoseError):
    """A setting is missing or impossible; the sentence names it and where it stands."""


def checked_text(check: Callable[[str], str]) -> AfterValidator:
    """A setting that a function checks: its `FleetPoseError` is what refuses it."""

    def validate(text: str) -> str:
        try:
            return check(text)
        except FleetPoseError as error:
            raise ValueError(str(error)) from error

    return AfterValidator(validate)


def listed(value: Any) -> Any:
    """A list may stand in the environment as JSON, or with commas or spaces."""
    if not isinstance(value, str):
        return value
    return json.loads(value) if value.lstrip().startswith("[") else re.split(r"[,\s]+", value)


Name = Annotated[str, checked_text(checked_name)]
Endpoints = Annotated[
    tuple[Annotated[str, checked_text(checked_endpoint)], ...], NoDecode, BeforeValidator(listed)
]


class ProcessSettings(BaseSettings):
    """Base of the settings of a process.

    Attributes:
        roles: whose zenoh configuration `config` may be.
        identified: the settings that a configuration knows when it says whose it is, by the part
            of the identity, e.g. `{"site": "site", "name": "operator"}`.
    """

    model_config = SettingsConfigDict(extra="forbid", frozen=True)
    roles: ClassVar[tuple[str, ...]] = ()
    identified: ClassVar[Mapping[str, str]] = {"site": "site"}

    @classmethod
    def load(cls, file: Path | None, given: Mapping[str, Any]) -> Self:
        """Builds the settings.

        Args:
            file: TOML, as `as_toml` writes it.
            given: what the command line gave; None counts as not given.

        Raises:
            SettingsRefusedError: one is unknown, missing or impossible, or the file cannot be read.
        """
        if file is not None and not file.is_file():
            raise SettingsRefusedError(f"settings file {file} does not exist")
        refuse_unknown_variables(cls)
        written = {name: value for name, value in given.items() if value is not None}

        token = _file.set(file)
        try:
            return cls(**written)
        except ValidationError as error:
            raise SettingsRefusedError(cls._sentence(error, file, written)) from error
        except (SettingsError, ValueError, OSError) as error:
            place = f" of {file}" if file is not None else ""
            cause = error.__cause__ or error
            raise SettingsRefusedError(f"the settings{place} cannot be read: {cause}") from error
        finally:
            _file.reset(token)

    @model_validator(mode="before")
    @classmethod
    def _identify(cls, given: dict[str, Any]) -> dict[str, Any]:
        """Site and name are those of the zenoh configuration, if it says whose it is."""
        config = given.get("config")
        if not config or not isinstance(config, str | Path):  # what is no path is told as that
            return given
        from fleetpose.protocol.session.identity import identity_in  # zenoh: only where it is used

        file = Path(config)
        identity = identity_in(file, cls.roles)
        if identity is None:
            return given
        own = {name: getattr(identity, part) for part, name in cls.identified.items()}
        for name, value in own.items():
            identity.settle(f"--{name}", given.get(name) or None, value, file)
        return given | own

    @classmethod
    def settings_customise_sources(
        cls,
        settings_cls: type[BaseSettings],
        init_settings: PydanticBaseSettingsSource,
        env_settings: PydanticBaseSettingsSource,
        dotenv_settings: PydanticBaseSettingsSource,
        file_secret_settings: PydanticBaseSettingsSource,
    ) -> tuple[PydanticBaseSettingsSource, ...]:
        """The command line goes before the environment, and that before the file."""
        file = TomlConfigSettingsSource(settings_cls, _file.get())
        return init_settings, env_settings, file

    @classmethod
    def _sentence(cls, error: ValidationError, file: Path | None, given: Mapping[str, Any]) -> str:
        first = error.errors()[0]
        name = str(first["loc"][0]) if first["loc"] else "?"
        said = first["msg"].removeprefix("Value error, ")
        if first["type"] == "extra_forbidden":
            return f"{file}: there is no setting '{name}'{_meant(name, cls.model_fields)}"
        variable = cls._prefix() + name.upper()
        place = "" if file is None else f" of {file}"
        if name in given:
            place = " of the command line"
        elif variable in {key.upper() for key in os.environ}:
            place = f" ({variable})"
        return f"setting '{name}'{place}: {said[:1].lower()}{said[1:]}"

    @classmethod
    def _prefix(cls) -> str:
        return str(cls.model_config.get("env_prefix", ""))

    def as_toml(self) -> str:
        """The settings as a file that `load` reads, each with what it means."""
        lines: list[str] = []
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            lines += [f"# {field.description}"] if field.description else []
            if value is None:
                lines.append(f"# {name} =")
            else:
                value = list(value) if isinstance(value, tuple) else value
                lines.append(f"{name} = {json.dumps(value, default=str, ensure_ascii=False)}")
        return "\n".join(lines) + "\n"


def refuse_unknown_variables(settings: type[ProcessSettings]) -> None:
    """Names a variable of the environment that looks like a setting of this process and is none.

    Raises:
        SettingsRefusedError: there is one.
    """
    prefix = settings._prefix()
    known = {prefix + name.upper() for name in settings.model_fields}
    for variable in os.environ:
        upper = variable.upper()
        ours = upper.startswith(prefix)
        others = upper.startswith(PREFIXES) and not ours
        if upper.startswith("FLEETPOSE_") and not others and upper not in known:
            raise SettingsRefusedError(
                f"{variable} in the environment is no setting{_meant(upper, known)}"
            )


def _meant(name: str, known: Mapping[str, Any] | set[str]) -> str:
    near = difflib.get_close_matches(name, list(known), 1, _CLOSE)
    return f"; is '{near[0]}' meant?" if near else ""


def with_options(
    settings: type[ProcessSettings], flags: Mapping[str, str] | None = None
) -> Callable[[F], F]:
    """Gives a command an option for every setting; it gets what was given as keyword arguments.

    Args:
        settings: whose fields they are.
        flags: options that are not called as their settings are, e.g. `{"rate_hz": "--rate"}`.
    """
    flags = flags or {}

    def decorate(command: F) -> F:
        own = list(inspect.signature(command).parameters.values())
        kept = [one for one in own if one.kind is not inspect.Parameter.VAR_KEYWORD]
        options = [
            inspect.Parameter(
                name,
                inspect.Parameter.KEYWORD_ONLY,
                default=None,
                annotation=_option(field, flags.get(name, f"--{name.replace('_', '-')}")),
            )
            for name, field in settings.model_fields.items()
        ]
        parameters = [one.replace(kind=inspect.Parameter.KEYWORD_ONLY) for one in kept]
        command.__signature__ = inspect.Signature([*options, *parameters])  # type: ignore[attr-defined]
        command.__annotations__ = {one.name: one.annotation for one in [*options, *parameters]}
        return command

    return decorate


def _option(field: FieldInfo, flag: str) -> Any:
    """The annotation of an option that is not given by default."""
    text = field.description or ""
    if text.partition(" ")[0].isalpha():  # else a value that is named, e.g. `rgbd:`
        text = text[:1].upper() + text[1:]
    default = field.get_default(call_default_factory=True)
    if field.is_required():
        text += " [required]"
    elif default is not None and default is not False and default not in ("", ()):
        shown = ", ".join(default) if isinstance(default, tuple) else default
        text += f" [default: {shown}]"
    kind, choices = _plain(field.annotation), _choices(field.annotation)
    option = typer.Option(
        flag,
        help=text,
        show_default=False,
        metavar=f"<{'|'.join(choices)}>" if choices else None,
        autocompletion=_beginning_of(choices) if choices else None,
    )
    return Annotated[kind | None, option]  # pyright: ignore[reportInvalidTypeForm]


def _choices(annotation: Any) -> tuple[str, ...]:
    """The values of a setting that takes a few words; else none."""
    return get_args(annotation) if get_origin(annotation) is Literal else ()


def _beginning_of(choices: tuple[str, ...]) -> Callable[[str], list[str]]:
    """For the shell: the words that begin as what is typed."""

    def complete(incomplete: str) -> list[str]:
        return [word for word in choices if word.startswith(incomplete)]

    return complete


def _plain(annotation: Any) -> Any:
    """The type of an option's value: bounds and patterns are the settings' business."""
    origin, inner = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _plain(inner[0])
    if origin in (Union, UnionType):
        return _plain(next(one for one in inner if one is not NoneType))
    if origin is tuple:
        return list[_plain(inner[0])]  # pyright: ignore[reportInvalidTypeArguments]
    if origin is Literal:
        return str
    return annotation


SettingsFile = Annotated[
    Path | None, typer.Option(help="Settings file (TOML), as --dump-settings prints it.")
]
DumpSettings = Annotated[
    bool, typer.Option("--dump-settings", "--dump-config", help="Print the settings and end.")
]
