"""TerminalDiff output makes the same picture as what it is made of, in fewer bytes."""

import re

from hypothesis import given
from hypothesis import strategies as st
from rich.cells import cell_len
from rich.color import ColorSystem
from rich.style import Style

from fleetpose.hmi_client.tui.terminal.terminal_diff import TerminalDiff

COLOURS = st.sampled_from(["#102030", "#a0b0c0", "red", "color(200)", "bright_blue", None])
STYLES = st.builds(
    Style,
    color=COLOURS,
    bgcolor=COLOURS,
    bold=st.sampled_from([True, None]),
    reverse=st.sampled_from([True, None]),
)
TEXTS = st.sampled_from(["▀", "▀▀▀", "ab", " ", "r12", "世界", "a世"])
SYSTEMS = st.sampled_from([ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT, ColorSystem.STANDARD])
SPANS = st.tuples(
    st.integers(1, 3), st.integers(1, 9), st.lists(st.tuples(TEXTS, STYLES), max_size=5)
)
FRAMES = st.lists(st.lists(SPANS, min_size=1, max_size=4), min_size=1, max_size=4)
CODE = re.compile(r"\x1b\[([0-9;]*)([mHC])")


class Terminal:
    """Shows what is written to it; knows only what Rich and Textual write."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int], tuple[str, tuple]] = {}
        self.look: dict[str, str] = {}
        self.at = (1, 1)

    def write(self, data: str) -> None:
        at = 0
        while at < len(data):
            code = CODE.match(data, at)
            y, x = self.at
            if code is None:
                if data[at] == "\n":
                    self.at = (y + 1, 1)
                else:
                    self._show(data[at])
                at += 1
                continue
            at = code.end()
            match code[2]:
                case "H":
                    row, column = code[1].split(";")
                    self.at = (int(row), int(column))
                case "C":
                    self.at = (y, x + int(code[1]))
                case _:
                    self._style(code[1].split(";"))

    def _show(self, character: str) -> None:
        y, x = self.at
        width = cell_len(character)
        for k in range(width):
            self.cells[y, x + k] = (character if k == 0 else "", tuple(sorted(self.look.items())))
        self.at = (y, x + width)

    def _style(self, numbers: list[str]) -> None:
        while numbers:
            n = numbers.pop(0) or "0"
            if n == "0":
                self.look = {}
            elif n in ("38", "48"):
                take = 4 if numbers[0] == "2" else 2
                self.look[n[0]] = ";".join(numbers[:take])
                del numbers[:take]
            elif n in ("39", "49"):
                self.look.pop(n[0], None)
            elif 30 <= int(n) <= 37 or 90 <= int(n) <= 97:
                self.look["3"] = n
            elif 40 <= int(n) <= 47 or 100 <= int(n) <= 107:
                self.look["4"] = n
            else:
                self.look[f"a{n}"] = n


def written(frame, system) -> str:
    """A frame as Textual writes it."""
    lines = [
        f"\x1b[{y};{x}H" + "".join(style.render(text, color_system=system) for text, style in runs)
        for y, x, runs in frame
    ]
    return "\n".join(lines) + "\x1b[1;1H"


@given(FRAMES, SYSTEMS, st.integers(0, 3))
def test_the_terminal_shows_the_same_after_each_frame(frames, system, forgotten):
    plain, spared, frugal = Terminal(), Terminal(), TerminalDiff()
    for number, frame in enumerate(frames):
        if number == forgotten:
            frugal.forget()
        data = written(frame, system)
        rewritten = frugal.rewritten(data)
        plain.write(data)
        spared.write(rewritten)
        assert spared.cells == plain.cells
        assert (spared.look, spared.at) == ({}, plain.at)
        assert len(rewritten) <= len(data)


def test_what_is_there_already_is_not_written_again():
    style = Style(color="#a0b0c0", bgcolor="#102030")
    data = written([(1, 1, [("▀▀▀", style), ("r12", Style())])], ColorSystem.TRUECOLOR)
    frugal = TerminalDiff()
    assert "r12" in frugal.rewritten(data)
    assert frugal.rewritten(data) == "\x1b[1;1H"
    frugal.forget()
    assert "r12" in frugal.rewritten(data)


def test_a_row_of_an_image_costs_less_where_a_colour_stays():
    runs = [("▀", Style(color="#a0b0c0", bgcolor=f"#0000{k:02x}")) for k in range(0, 160, 8)]
    data = written([(1, 1, runs)], ColorSystem.TRUECOLOR)
    assert len(TerminalDiff().rewritten(data)) < 0.6 * len(data)


def test_what_cannot_be_followed_passes_and_ends_all_knowledge():
    frugal = TerminalDiff()
    data = written([(1, 1, [("r12", Style(bold=True))])], ColorSystem.TRUECOLOR)
    for other in ("\x1b[?1049h", "\x1b[2J", "plain text", "\x1b]52;c;eA==\a", "\x1b[>1u"):
        frugal.rewritten(data)
        assert frugal.rewritten(other) == other
        assert "r12" in frugal.rewritten(data)
    assert frugal.rewritten("\x1b[?2026h") == "\x1b[?2026h"
    assert "r12" not in frugal.rewritten(data)
