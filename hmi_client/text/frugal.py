"""What goes to the terminal, with no more colour codes than it takes.

Textual writes each run of cells with all of its style and a reset behind it. Over SSH an image is
mostly colour codes; neighbours often share one of their two colours.
"""

import re
from functools import lru_cache

_SGR = re.compile(r"\x1b\[([0-9;]*)m")
_MOVES = re.compile(r"(?:\x1b\[[0-9;]*H|\n)+")  # they look the same in every colour
_PLAIN = ("", "", "")
Look = tuple[str, str, str]
"""Attributes, foreground and background, each as codes; empty: the terminal's own."""


def frugal(data: str) -> str:
    """The same picture in fewer bytes; like the input it begins and ends with a plain look.

    Every style in the input must be told whole, after a reset, as Rich and Textual do.
    """
    parts = _SGR.split(data)
    if len(parts) == 1:
        return data
    out = [parts[0]]
    here = wanted = _PLAIN
    for codes, text in zip(parts[1::2], parts[2::2], strict=True):
        wanted = look_of(codes)
        if text:
            if wanted != here and not _MOVES.fullmatch(text):
                out.append(change(here, wanted))
                here = wanted
            out.append(text)
    if here != _PLAIN:
        out.append(change(here, _PLAIN))
    return "".join(out)


@lru_cache(maxsize=1 << 16)
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


@lru_cache(maxsize=1 << 16)
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
