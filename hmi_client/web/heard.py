"""What pages say: JSON texts, checked before anybody acts on them."""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from fleetpose.hmi_client.desk.keymap import IDS
from fleetpose.protocol.errors import FleetPoseError

LONGEST = 65_536  # bytes of a frame
_LONGEST_TEXT = 200
_SETTINGS = 16_384  # characters


class MalformedError(FleetPoseError):
    """A frame that no page of ours sends; the sentence says what is wrong with it."""


@dataclass(frozen=True)
class Heard:
    """One command of a page and its arguments, each of the right type."""

    do: str
    args: Mapping[str, Any] = field(default_factory=dict)


def parse(text: str) -> Heard:
    """Reads a frame.

    Raises:
        MalformedError: it is no command, or an argument of it is of another type.
    """
    try:
        told = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise MalformedError("the frame is no JSON") from error
    if not isinstance(told, dict) or not isinstance(told.get("do"), str):
        raise MalformedError('the frame is no object with "do"')
    do = told.pop("do")
    if do not in COMMANDS:
        raise MalformedError(f"there is no command {do[:40]!r}")
    for name, value in told.items():
        check = _ARGUMENTS.get(name)
        if check is None or not check(value):
            raise MalformedError(f"{do}: {name[:40]!r} is not right")
    return Heard(do, told)


def _no_constant(name: str) -> NoReturn:
    raise ValueError(name)


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:
        return False


def _is_pixel(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(map(_is_number, value))


def _is_window(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 4 and all(map(_is_number, value))


def _is_text(value: Any) -> bool:
    return isinstance(value, str) and len(value) <= _LONGEST_TEXT


def _is_count(value: Any) -> bool:
    return type(value) is int and 0 <= value < 2**63


def _is_value(value: Any) -> bool:
    return _is_number(value) or _is_text(value)


def _is_settings(value: Any) -> bool:
    return isinstance(value, dict) and len(json.dumps(value)) <= _SETTINGS


def _is_yes_or_no(value: Any) -> bool:
    return isinstance(value, bool)


_ARGUMENTS: Mapping[str, Callable[[Any], bool]] = {
    "side": lambda value: type(value) is int and value in (0, 1),
    "pixel": _is_pixel,
    "view": _is_count,
    "beside": _is_count,
    "id": _is_count,
    "number": _is_count,
    "a": _is_text,
    "b": _is_text,
    "robot": _is_text,
    "token": _is_text,
    "v": _is_count,
    "at": _is_number,
    "s": _is_number,
    "value": _is_value,
    "apart": _is_pixel,
    "within": _is_window,
    "step": _is_number,
    "paused": _is_yes_or_no,
    "images": _is_yes_or_no,
    "clouds": _is_yes_or_no,
    "matrix": _is_yes_or_no,
    "set": _is_settings,
}
_OF_PAGES = ("hello", "ack", "want", "ping", "settings", "cursor")
OF_RECORDINGS = ("play", "seek", "speed")
COMMANDS = frozenset((*IDS, *_OF_PAGES, *OF_RECORDINGS))
