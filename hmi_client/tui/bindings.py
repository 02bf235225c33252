"""All keys: what they do, where they work, and how a file changes them.

A binding with an id can be given other keys; the same id in two panels is one command.
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from textual.binding import Binding
from textual.keys import Keys

from fleetpose.hmi_client.errors import OperatorError


def _key(keys: str, action: str, label: str, id: str, does: str, show: bool = True) -> Binding:
    return Binding(keys, action, label, id=id, tooltip=does, show=show)


def _arrows(coarse: int) -> list[Binding]:
    """Arrows by one, with Shift by more."""
    ways = {"up": (0, -1), "down": (0, 1), "left": (-1, 0), "right": (1, 0)}
    return [
        Binding(f"{shift}{name}", f"move({step * x},{step * y})", show=False)
        for shift, step in (("", 1), ("shift+", coarse))
        for name, (x, y) in ways.items()
    ]


EVERYWHERE = [
    _key("n", "question(1)", "Next", "next", "the next question, the most useful one first"),
    _key("p", "question(-1)", "Prev", "previous", "the question before"),
    _key("u", "undo", "Undo", "undo", "take the last step back"),
    _key("r", "redo", "Redo", "redo", "do again what was taken back"),
    _key("x", "erase", "Erase", "erase", "erase the point near the cursor, or that of the list"),
    _key("c,escape", "cancel", "Cancel", "cancel", "drop half a pick, leave suggestions"),
    _key("f", "freeze", "Freeze", "freeze", "hold both images still, or let them go on"),
    _key("m", "maximise", "Max", "maximise", "the images only, or all panels"),
    _key("o", "overview", "Overview", "overview", "all pairs at once, in colours"),
    _key("y", "why", "Why", "why", "why a robot is located, or not, and what to do"),
    _key("b", "site(1)", "Site", "site", "the next site, of those that --site A,B names"),
    _key("B", "site(-1)", "Site", "site-before", "the site before", show=False),
    _key("l", "events", "Events", "events", "what happened, the newest first", show=False),
    _key("question_mark", "help", "Help", "help", "this page"),
    _key("q", "quit", "Quit", "quit", "leave; clicks on their way are kept"),
    _key(
        "left_square_bracket",
        "threshold(-1)",
        "Hide",
        "hide-more",
        "more errors become a hyphen",
    ),
    _key(
        "right_square_bracket", "threshold(1)", "Show", "show-more", "fewer errors become a hyphen"
    ),
    *(
        _key(str(n), f"panel({n})", name, f"panel-{name}", f"the keys go to: {where}", show=False)
        for n, (name, where) in enumerate(
            (
                ("map", "the map"),
                ("matrix", "the matrix"),
                ("list", "the list of points"),
                ("left", "the first image"),
                ("right", "the second image"),
            ),
            start=1,
        )
    ),
    _key("ctrl+l", "redraw", "Redraw", "redraw", "draw the whole screen again", show=False),
    Binding("ctrl+c", "quit", show=False, priority=True),
]
_ZOOM = (
    _key("plus,equals_sign", "zoom(1.5)", "Zoom", "zoom-in", "nearer", show=False),
    _key("minus", "zoom(0.6667)", "Out", "zoom-out", "farther", show=False),
    _key("0", "fit", "Fit", "fit", "all of it", show=False),
)
IMAGES = [
    _key("space,enter", "pick", "Pick", "pick", "pick the point under the cursor"),
    _key("g", "hint", "Go to", "go", "labels on places worth a pick; type one to go there"),
    _key("s", "snap", "Snap", "snap", "to the nearest corner, or point with depth"),
    _key("tab", "suggestion(1)", "Suggested", "accept", "show a suggestion; accept it"),
    _key("shift+tab", "suggestion(-1)", "Skip", "skip", "skip the suggestion", show=False),
    _key("v", "move_point", "Move", "move", "the nearest point moves to the cursor", show=False),
    *_ZOOM,
    *_arrows(10),
]
MATRIX = [
    _key("enter", "choose", "Select", "select", "look at the pair under the cursor"),
    _key("t", "quantity", "Quantity", "quantity", "errors, overlap, age, verdicts or doubt"),
    *_arrows(8),
]
MAP = [
    *_ZOOM,
    _key("e", "ellipses", "Ellipses", "ellipses", "two sigma around each robot, or not"),
    _key("w", "follow", "Follow", "follow", "keep the selected pair in the middle"),
    *_arrows(4),
]
LIST = [
    _key("enter", "show", "Show", "show", "the images that a point was clicked in"),
    Binding("up", "move(0,-1)", show=False),
    Binding("down", "move(0,1)", show=False),
]
PLACES: Mapping[str, list[Binding]] = {
    "Everywhere": EVERYWHERE,
    "Images": IMAGES,
    "Matrix": MATRIX,
    "Map": MAP,
    "List": LIST,
}
_PRINTED = {
    "left_square_bracket": "[",
    "right_square_bracket": "]",
    "question_mark": "?",
    "plus": "+",
    "minus": "-",
    "equals_sign": "=",
    "comma": ",",
    "full_stop": ".",
    "shift+tab": "Shift-Tab",
    "tab": "Tab",
    "space": "Space",
    "enter": "Enter",
    "escape": "Esc",
}
_NAMED = {name: key for key, name in _PRINTED.items() if len(name) == 1}


@dataclass(frozen=True)
class KeyMap:
    """Which keys each command has; `changed` are those that a file gives it, by its id."""

    changed: Mapping[str, str]

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
        known = [b.id for b in _with_ids(*PLACES.values())]
        for id in told:
            if id not in known:
                raise OperatorError(
                    f"{path}: there is no command '{id}'; hmi-client keys shows all"
                )
        keymap = cls({id: _keys_of(f"{path}: {id}", keys) for id, keys in told.items()})
        keymap._check(path)
        return keymap

    def keys(self, binding: Binding) -> str:
        """The keys of a command, with commas between them."""
        return self.changed.get(binding.id or "", binding.key)

    def names(self) -> dict[str, str]:
        """The first key of each command, as it is printed on a keyboard."""
        return {
            b.id or "": printed(self.keys(b).split(",")[0]) for b in _with_ids(*PLACES.values())
        }

    def as_toml(self) -> str:
        """A file that `read` takes."""
        lines = ["# Keys of the commands of hmi-client. Leave out what should stay as it is."]
        told: set[str] = set()
        for where, bindings in PLACES.items():
            fresh = [b for b in _with_ids(bindings) if b.id not in told]
            lines += ["", f"# {where}"] if fresh else []
            for b in fresh:
                told.add(b.id or "")
                names = ", ".join(f'"{key}"' for key in self.keys(b).split(","))
                value = f"[{names}]" if "," in names else names
                lines.append(f"{f'{b.id} = {value}':<36} # {b.tooltip}")
        return "\n".join(lines) + "\n"

    def _check(self, path: Path) -> None:
        for where, bindings in PLACES.items():
            taken: dict[str, str] = {}
            here = [] if bindings is EVERYWHERE else bindings
            for b in (*EVERYWHERE, *here):
                for key in self.keys(b).split(","):
                    name = b.id or b.action
                    if taken.setdefault(key, name) != name and (
                        taken[key] in self.changed or name in self.changed
                    ):
                        both = f"both '{taken[key]}' and '{name}' ({where.lower()})"
                        raise OperatorError(f"{path}: '{printed(key)}' is given to {both}")


def _with_ids(*lists: Iterable[Binding]) -> list[Binding]:
    return [binding for bindings in lists for binding in bindings if binding.id]


def _keys_of(what: str, told: object) -> str:
    told = told if isinstance(told, list) else [told]
    keys = [key for key in told if isinstance(key, str) and key]
    if not keys or len(keys) != len(told):
        raise OperatorError(f'{what}: write "n", or ["space", "enter"]')
    return ",".join(_key_of(what, key) for key in keys)


def _key_of(what: str, told: str) -> str:
    """A key by Textual's name; single characters are themselves."""
    *modifiers, last = told.split("+") if len(told) > 1 else [told]
    key = _NAMED.get(last, last)
    known = len(key) == 1 or key in _PRINTED or key in {k.value for k in Keys}
    if not known or not set(modifiers) <= {"ctrl", "shift", "alt"}:
        raise OperatorError(f"{what}: '{told}' is no key; examples: n, ?, space, f5, ctrl+n")
    return "+".join((*modifiers, key))


def printed(key: str) -> str:
    """A key as it is printed on a keyboard."""
    return _PRINTED.get(key, key)
