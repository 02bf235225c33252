"""What goes to the terminal: only what is not there yet, in no more colour codes than it takes.

Textual writes a line of a widget from its start to the last cell that changed, each run of cells
with all of its style and a reset behind it. Over SSH an image is mostly colour codes; of a moving
one half the cells stay as they are, and neighbours often share one of their two colours.
"""

import re
from functools import lru_cache

from rich.cells import cell_len

_TOKENS = re.compile(
    r"\x1b\[([0-9;]*)m|\x1b\[([0-9]+);([0-9]+)H|(\n)|([^\x00-\x1f\x7f]+)|(.)", re.S
)
_HARMLESS = re.compile(r"\x1b\[\?2026[hl]")  # a frame begins or ends
Look = tuple[str, str, str]
"""Attributes, foreground and background, each as codes; empty: the terminal's own."""
Cell = tuple[str, Look] | None
_PLAIN: Look = ("", "", "")


class Frugal:
    """Keeps what the terminal shows, and rewrites output so that it says the rest only.

    What it writes begins and ends with a plain look, as what it is given does. Styles must be told
    whole, after a reset, as Rich and Textual do.
    """

    def __init__(self) -> None:
        self._rows: dict[int, list[Cell]] = {}

    def forget(self) -> None:
        """The terminal may show anything: others wrote to it, or its size has changed."""
        self._rows.clear()

    def rewritten(self, data: str) -> str:
        """Output that has the same effect."""
        out = _Writer()
        target: tuple[int, int] | None = None
        look = _PLAIN
        for codes, row, column, newline, text, other in _TOKENS.findall(data):
            if text:
                if target is None:
                    return self._unknown(data)
                target = self._put(out, target, text, look)
            elif row:
                target = int(row), int(column)
            elif newline:
                target = None  # a move follows
            elif other:
                return self._unknown(data)
            else:
                look = look_of(codes)
        return out.finished(target)

    def _unknown(self, data: str) -> str:
        """Passes on what cannot be followed."""
        if not _HARMLESS.fullmatch(data):
            self.forget()
        return data

    def _put(
        self, out: "_Writer", target: tuple[int, int], text: str, look: Look
    ) -> tuple[int, int]:
        """Writes a run unless it is there; returns where the next one begins."""
        y, x = target
        width = len(text) if text.isascii() else cell_len(text)
        row = self._rows.setdefault(y, [])
        if len(row) < x + width:
            row.extend([None] * (x + width - len(row)))
        if width == len(text):
            cells: list[Cell] = [(character, look) for character in text]
        else:  # wide characters: not kept, always written
            cells = [None] * width
        if None in cells or row[x : x + width] != cells:
            out.write(target, text, look, width)
            row[x : x + width] = cells
        return y, x + width


class _Writer:
    """Puts runs together, with moves and changes of the look between them."""

    def __init__(self) -> None:
        self._parts: list[str] = []
        self._at: tuple[int, int] | None = None
        self._look = _PLAIN

    def write(self, where: tuple[int, int], text: str, look: Look, width: int) -> None:
        if where != self._at:
            self._parts.append(_move(self._at, where))
        if look != self._look:
            self._parts.append(change(self._look, look))
            self._look = look
        self._parts.append(text)
        self._at = where[0], where[1] + width

    def finished(self, where: tuple[int, int] | None) -> str:
        """All of it, with a plain look and the cursor at `where`."""
        if self._look != _PLAIN:
            self._parts.append(change(self._look, _PLAIN))
        if where is not None and where != self._at:
            self._parts.append(_move(None, where))
        return "".join(self._parts)


def _move(here: tuple[int, int] | None, there: tuple[int, int]) -> str:
    """Never relative to the end of a line, where terminals differ: only forward past what is
    known to be there.
    """
    if here is not None and here[0] == there[0] and here[1] < there[1]:
        return f"\x1b[{there[1] - here[1]}C"
    return f"\x1b[{there[0]};{there[1]}H"


@lru_cache(maxsize=1 << 13)
def look_of(codes: str) -> Look:
    """What a whole style says."""
    attributes: list[str] = []
    colours = {"3": "", "4": ""}
    numbers = codes.split(";")
    while numbers:
        number = numbers.pop(0)
        if number in ("38", "48"):
            length = 4 if numbers[:1] == ["2"] else 2
            colours[number[0]] = ";".join((number, *numbers[:length]))
            del numbers[:length]
        elif number in ("39", "49"):
            colours[number[0]] = ""
        elif len(number) == 2 and number[0] in "34":
            colours[number[0]] = number
        elif len(number) >= 2 and number.startswith(("9", "10")):
            colours["3" if number[0] == "9" else "4"] = number
        elif number not in ("", "0"):
            attributes.append(number)
    return ";".join(attributes), colours["3"], colours["4"]


@lru_cache(maxsize=1 << 13)
def change(here: Look, wanted: Look) -> str:
    """The shortest code from one look to another."""
    if wanted == _PLAIN:
        return "\x1b[m"
    if wanted[0] != here[0]:
        codes = [("0" if here != _PLAIN else ""), *wanted]
        return f"\x1b[{';'.join(code for code in codes if code)}m"
    codes = [
        new or default
        for new, old, default in zip(wanted[1:], here[1:], ("39", "49"), strict=True)
        if new != old
    ]
    return f"\x1b[{';'.join(codes)}m"
