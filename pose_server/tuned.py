"""Numbers that were fitted to recordings and not derived: fields of settings objects, each beside
the code that goes by it, with its unit.

Where no comment says which recordings a number was set on, that was not written down. What a fifth
more and less of one costs on a recording prints `pose-eval ablate GROUP.NUMBER`.
"""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

Settings = TypeVar("Settings")
_GROUPS: dict[str, Any] = {}


def in_use(group: str, settings: Settings) -> Settings:
    """The settings that a module goes by, known by the name of their group."""
    _GROUPS[group] = settings
    return settings


def tuned() -> Mapping[str, object]:
    """The numbers of all modules that are loaded, by GROUP.NUMBER."""
    return {
        f"{group}.{one.name}": getattr(settings, one.name)
        for group, settings in sorted(_GROUPS.items())
        for one in fields(settings)
    }


def replace_in_use(name: str, value: object) -> None:
    """Has this process go by another number from now on: for `pose-eval ablate` alone.

    Raises:
        KeyError: there is no such number.
    """
    if name not in tuned():
        raise KeyError(name)
    group, _, number = name.partition(".")
    object.__setattr__(_GROUPS[group], number, value)
