"""All commands: what they do, where they work, which keys they have, and how a file changes these.

The same command may have its key in two places. Keys are written as in a file of keys: `n`, `?`,
`space`, `shift+tab`, `f5`, `ctrl+n`.
"""

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from fleetpose.hmi_client.errors import OperatorError

Place = Literal["everywhere", "images", "matrix", "map", "list"]
PLACES: tuple[Place, ...] = get_args(Place)
_PRINTED = {
    "shift+tab": "Shift-Tab",
    "tab": "Tab",
    "space": "Space",
    "enter": "Enter",
    "escape": "Esc",
}
_SPELLED = {
    "left_square_bracket": "[",
    "right_square_bracket": "]",
    "question_mark": "?",
    "plus": "+",
    "minus": "-",
    "equals_sign": "=",
    "comma": ",",
    "full_stop": ".",
}
_NAMED = {"up", "down", "left", "right", "home", "end", "pageup", "pagedown", "insert", "delete"}
_NAMED |= {"backspace", "tab", "space", "enter", "escape"}


@dataclass(frozen=True)
class Command:
    """What an operator can do.

    Attributes:
        id: how files of keys, desks and pages call it.
        place: where its keys work.
        keys: that it has unless a file gives it others.
        label: a word for a button or a footer.
        does: what it does, in a few words.
        shown: whether it stands in the footer.
        view: whether it changes only how a face shows things: a desk has nothing to do for it.
    """

    id: str
    place: Place
    keys: tuple[str, ...]
    label: str
    does: str
    shown: bool = True
    view: bool = False


def _of(place: Place, *commands: tuple[str, str, str, str, str]) -> tuple[Command, ...]:
    """Commands from lines of id, keys, label, what it does, and marks: h hidden, v view."""
    return tuple(
        Command(id, place, tuple(keys.split(" ")), label, does, "h" not in marks, "v" in marks)
        for id, keys, label, does, marks in commands
    )


_ZOOM = (
    ("zoom-in", "+ =", "Zoom", "nearer", "hv"),
    ("zoom-out", "-", "Out", "farther", "hv"),
    ("fit", "0", "Fit", "all of it", "hv"),
)
COMMANDS: tuple[Command, ...] = (
    *_of(
        "everywhere",
        ("help", "?", "Help", "all keys and signs", ""),
        ("quit", "q", "Quit", "leave; clicks on their way are kept", ""),
        ("next", "n", "Next", "the next question, the most useful one first", ""),
        ("previous", "p", "Prev", "the question before", ""),
        ("undo", "u", "Undo", "take the last step back", ""),
        ("redo", "r", "Redo", "do again what was taken back", ""),
        ("erase", "x", "Erase", "erase the point near the cursor, or that of the list", ""),
        ("look", "d", "Look", "show the point that does not fit the others", "h"),
        ("cancel", "c escape", "Cancel", "drop half a pick, leave suggestions", ""),
        ("freeze", "f", "Freeze", "hold both images still, or let them go on", ""),
        ("maximise", "m", "Max", "the images only, or all panels", ""),
        ("overview", "o", "Overview", "all pairs at once, in colours", ""),
        ("why", "y", "Why", "why a robot is located, or not, and what to do", ""),
        ("site", "b", "Site", "the next site, of those that --site A,B names", "v"),
        ("site-before", "B", "Site", "the site before", "hv"),
        ("events", "l", "Events", "what happened, the newest first", "h"),
        ("hide-more", "[", "Hide", "more errors become a hyphen", ""),
        ("show-more", "]", "Show", "fewer errors become a hyphen", ""),
        ("panel-map", "1", "map", "the keys go to: the map", "hv"),
        ("panel-matrix", "2", "matrix", "the keys go to: the matrix", "hv"),
        ("panel-list", "3", "list", "the keys go to: the list of points", "hv"),
        ("panel-left", "4", "left", "the keys go to: the first image", "hv"),
        ("panel-right", "5", "right", "the keys go to: the second image", "hv"),
        ("redraw", "ctrl+l", "Redraw", "draw the whole screen again", "hv"),
    ),
    *_of(
        "images",
        ("pick", "space enter", "Pick", "pick the point under the cursor", ""),
        ("go", "g", "Go to", "labels on places worth a pick; type one to go there", ""),
        ("snap", "s", "Snap", "to the nearest corner, or point with depth", ""),
        ("accept", "tab", "Suggested", "show a suggestion; accept it", ""),
        ("skip", "shift+tab", "Skip", "skip the suggestion", "h"),
        ("back", "a", "Back", "the suggestion before", "h"),
        ("move", "v", "Move", "the nearest point moves to the cursor", "h"),
        *_ZOOM,
    ),
    *_of(
        "matrix",
        ("select", "enter", "Select", "look at the pair under the cursor", ""),
        ("quantity", "t", "Quantity", "residual, pose sigma, overlap, age, verdicts or doubt", ""),
    ),
    *_of(
        "map",
        *_ZOOM,
        ("ellipses", "e", "Ellipses", "two sigma around each robot, or not", ""),
        ("follow", "w", "Follow", "keep the selected pair in the middle", ""),
    ),
    *_of("list", ("show", "enter", "Show", "the images that a point was clicked in", "")),
)
IDS: tuple[str, ...] = tuple(dict.fromkeys(command.id for command in COMMANDS))


def of_place(place: Place) -> tuple[Command, ...]:
    """The commands whose keys work in a place."""
    return tuple(command for command in COMMANDS if command.place == place)


@dataclass(frozen=True)
class KeyMap:
    """Which keys each command has; `changed` are those that a file gives it, by its id."""

    changed: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> "KeyMap":
        """Reads a TOML file of lines such as `next = "n"` or `pick = ["space", "enter"]`.

        Raises:
            OperatorError: the file cannot be read, a command is not known, or a key has two.
        """
        try:
            told = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise OperatorError(f"{path} cannot be read: {error.strerror}") from error
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise OperatorError(f"{path} is no valid TOML: {error}") from error
        for id in told:
            if id not in IDS:
                raise OperatorError(
                    f"{path}: there is no command '{id}'; hmi-client keys shows all"
                )
        keymap = cls({id: _keys_of(f"{path}: {id}", keys) for id, keys in told.items()})
        keymap._check(path)
        return keymap

    def keys(self, command: Command) -> tuple[str, ...]:
        """The keys of a command."""
        return self.changed.get(command.id, command.keys)

    def names(self) -> dict[str, str]:
        """The first key of each command, as it is printed on a keyboard, by the commands' ids."""
        return {command.id: printed(self.keys(command)[0]) for command in COMMANDS}

    def as_toml(self) -> str:
        """A file that `read` takes."""
        lines = ["# Keys of the commands of hmi-client. Leave out what should stay as it is."]
        told: set[str] = set()
        for place in PLACES:
            fresh = [command for command in of_place(place) if command.id not in told]
            lines += ["", f"# {place.capitalize()}"] if fresh else []
            for command in fresh:
                told.add(command.id)
                names = ", ".join(f'"{key}"' for key in self.keys(command))
                value = f"[{names}]" if "," in names and len(self.keys(command)) > 1 else names
                lines.append(f"{f'{command.id} = {value}':<36} # {command.does}")
        return "\n".join(lines) + "\n"

    def as_json(self) -> list[dict[str, Any]]:
        """All commands with their keys, for a page."""
        return [
            {
                "id": command.id,
                "place": command.place,
                "keys": list(self.keys(command)),
                "label": command.label,
                "does": command.does,
                "shown": command.shown,
            }
            for command in COMMANDS
        ]

    def _check(self, path: Path) -> None:
        for place in PLACES:
            taken: dict[str, str] = {}
            here = () if place == "everywhere" else of_place(place)
            for command in (*of_place("everywhere"), *here):
                for key in self.keys(command):
                    other = taken.setdefault(key, command.id)
                    if other != command.id and {other, command.id} & set(self.changed):
                        both = f"both '{other}' and '{command.id}' ({place})"
                        raise OperatorError(f"{path}: '{printed(key)}' is given to {both}")


def printed(key: str) -> str:
    """A key as it is printed on a keyboard."""
    return _PRINTED.get(key, key)


def _keys_of(what: str, told: object) -> tuple[str, ...]:
    told = told if isinstance(told, list) else [told]
    keys = [key for key in told if isinstance(key, str) and key]
    if not keys or len(keys) != len(told):
        raise OperatorError(f'{what}: write "n", or ["space", "enter"]')
    return tuple(_key_of(what, key) for key in keys)


def _key_of(what: str, told: str) -> str:
    *modifiers, last = told.split("+") if len(told) > 1 else [told]
    key = _SPELLED.get(last, last)
    known = len(key) == 1 or key in _NAMED or re.fullmatch(r"f([1-9]|1\d|2[0-4])", key)
    if not known or not set(modifiers) <= {"ctrl", "shift", "alt"}:
        raise OperatorError(f"{what}: '{told}' is no key; examples: n, ?, space, f5, ctrl+n")
    return "+".join((*modifiers, key))
