"""The keys of the commands, as Textual wants them; and the arrows, which belong to no command."""

from collections.abc import Iterable

from textual.binding import Binding

from fleetpose.hmi_client.desk.keymap import KeyMap, Place, of_place

_TEXTUALS = {
    "[": "left_square_bracket",
    "]": "right_square_bracket",
    "?": "question_mark",
    "+": "plus",
    "-": "minus",
    "=": "equals_sign",
    ",": "comma",
    ".": "full_stop",
}


def textual_keys(keys: Iterable[str]) -> str:
    """Keys by Textual's names, with commas between them."""
    return ",".join(_textual(key) for key in keys)


def changed_keys(keymap: KeyMap) -> dict[str, str]:
    """What a file changes, for `App.set_keymap`."""
    return {id: textual_keys(keys) for id, keys in keymap.changed.items()}


def _textual(key: str) -> str:
    *modifiers, last = key.split("+") if len(key) > 1 else [key]
    return "+".join((*modifiers, _TEXTUALS.get(last, last)))


def _of(place: Place) -> list[Binding]:
    return [
        Binding(
            textual_keys(command.keys),
            f"do('{command.id}')",
            command.label,
            id=command.id,
            tooltip=command.does,
        )
        for command in of_place(place)
    ]


def _arrows(coarse: int) -> list[Binding]:
    """Arrows by one, with Shift by more."""
    ways = {"up": (0, -1), "down": (0, 1), "left": (-1, 0), "right": (1, 0)}
    return [
        Binding(f"{shift}{name}", f"arrow({step * x},{step * y})", show=False)
        for shift, step in (("", 1), ("shift+", coarse))
        for name, (x, y) in ways.items()
    ]


EVERYWHERE = [*_of("everywhere"), Binding("ctrl+c", "do('quit')", show=False, priority=True)]
IMAGES = [*_of("images"), *_arrows(10)]
MATRIX = [*_of("matrix"), *_arrows(8)]
MAP = [*_of("map"), *_arrows(4)]
LIST = [*_of("list"), *_arrows(5)]
