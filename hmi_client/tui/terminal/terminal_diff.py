"""What goes to the terminal: only what is not there yet, in no more colour codes than it takes.

Textual writes a line of a widget from its start to the last cell that changed, each run of cells
with all of its style and a reset behind it. Over SSH an image is mostly colour codes; of a moving
one half the cells stay as they are, and neighbours often share one of their two colours.
"""

import re
from functools import lru_cache

from rich.cells import cell_len

_SGR = re.compile(r"[0-9;]*")
_MOVE = re.compile(r"([0-9]+);([0-9]+)H")
_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_HARMLESS = re.compile(r"\x1b\[\?2026[hl]")  # a frame begins or ends
_MOST_CODES = 1 << 13
Look = tuple[str, str, str]
"""Attributes, foreground and background, each as codes; empty: the terminal's own."""
_PLAIN: Look = ("", "", "")


class TerminalDiff:
    """Keeps what the terminal shows, and rewrites output so that it says the rest only.

    What it writes begins and ends with a plain look, as what it is given does. Styles must be told
    whole, after a reset, as Rich and Textual do.
    """

    def __init__(self) -> None:
        self._rows: dict[int, _Row] = {}
        self._styles: set[str] = set()  # codes that have been seen to be styles

    def forget(self) -> None:
        """The terminal may show anything: others wrote to it, or its size has changed."""
        self._rows.clear()

    def rewritten(self, data: str) -> str:
        """Output that has the same effect."""
        out = _Writer()
        row: _Row | None = None  # none: where it goes on is not known
        x = 0
        begin, *parts = data.split("\x1b[")
        if begin or not parts:
            return self._unknown(data)
        for part in parts:
            codes, end, text = part.partition("m")
            if codes not in self._styles or not end:
                if end and self._is_style(codes):
                    pass
                elif (move := _MOVE.match(part)) is not None:
                    y, x = int(move[1]), int(move[2])
                    row = self._rows.get(y) or self._rows.setdefault(y, _Row(y))
                    codes, text = "", part[move.end() :]
                else:
                    return self._unknown(data)
            if not text:
                continue
            ended = text[-1] == "\n"
            text = text.removesuffix("\n")
            if text and (row is None or _CONTROL.search(text)):
                return self._unknown(data)
            if text and row is not None:
                x = row.put(out, x, text, codes)
            if ended:
                row = None  # a move follows
        return out.finished(None if row is None else (row.y, x))

    def _is_style(self, codes: str) -> bool:
        if not _SGR.fullmatch(codes):
            return False
        if len(self._styles) >= _MOST_CODES:
            self._styles.clear()
        self._styles.add(codes)
        return True

    def _unknown(self, data: str) -> str:
        """Passes on what cannot be followed."""
        if not _HARMLESS.fullmatch(data):
            self.forget()
        return data


class _Row:
    """What a row of the terminal shows: characters, and each one's style as it was told."""

    def __init__(self, y: int) -> None:
        self.y = y
        self._characters: list[str] = []
        self._styles: list[str] = []

    def put(self, out: "_Writer", x: int, text: str, codes: str) -> int:
        """Writes a run unless it is there; returns where the next one begins."""
        width = 1 if text == "▀" else len(text) if text.isascii() else cell_len(text)
        after = x + width
        missing = after - len(self._characters)
        if missing > 0:
            self._characters += [""] * missing
            self._styles += [""] * missing
        if width == 1:
            if self._characters[x] != text or self._styles[x] != codes:
                self._characters[x], self._styles[x] = text, codes
                out.write((self.y, x), text, codes, after)
            return after
        narrow = width == len(text)  # wide characters are not kept but always written
        here = slice(x, after)
        characters, styles = list(text) if narrow else [""] * width, [codes] * width
        there = self._characters[here] == characters and self._styles[here] == styles
        if not there or not narrow:
            self._characters[here], self._styles[here] = characters, styles
            out.write((self.y, x), text, codes, after)
        return after


class _Writer:
    """Puts runs together, with moves and changes of the look between them."""

    def __init__(self) -> None:
        self._parts: list[str] = []
        self._at: tuple[int, int] | None = None
        self._codes, self._look = "", _PLAIN

    def write(self, where: tuple[int, int], text: str, codes: str, after: int) -> None:
        if where != self._at:
            self._parts.append(_move(self._at, where))
        if codes != self._codes:
            look = look_of(codes)
            self._parts.append(change(self._look, look))
            self._codes, self._look = codes, look
        self._parts.append(text)
        self._at = where[0], after

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


@lru_cache(maxsize=1 << 12)
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


def change(here: Look, wanted: Look) -> str:
    """The shortest code from one look to another."""
    attributes, front, back = wanted
    if attributes == here[0] and front and back:  # nearly always, so it is quick
        if front == here[1]:
            return f"\x1b[{back}m"
        return f"\x1b[{front}m" if back == here[2] else f"\x1b[{front};{back}m"
    if wanted == _PLAIN:
        return "\x1b[m"
    if attributes != here[0]:
        codes = ("" if here == _PLAIN else "0", attributes, front, back)
        return f"\x1b[{';'.join(code for code in codes if code)}m"
    codes = (
        front or "39" if front != here[1] else "",
        back or "49" if back != here[2] else "",
    )
    return f"\x1b[{';'.join(code for code in codes if code)}m"
