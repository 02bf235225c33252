"""Frugal output looks the same, in fewer bytes."""

import re

from hypothesis import given
from hypothesis import strategies as st
from rich.color import ColorSystem
from rich.style import Style

from hmi_client.text.frugal import frugal

COLOURS = st.sampled_from(["#102030", "#a0b0c0", "red", "color(200)", "bright_blue", None])
STYLES = st.builds(
    Style,
    color=COLOURS,
    bgcolor=COLOURS,
    bold=st.sampled_from([True, None]),
    reverse=st.sampled_from([True, None]),
)
RUNS = st.lists(
    st.tuples(st.sampled_from(["▀", "ab", " ", "\x1b[3;7H", "\n", "\x1b[2;1H\n"]), STYLES),
    max_size=12,
)
SYSTEMS = st.sampled_from([ColorSystem.TRUECOLOR, ColorSystem.EIGHT_BIT, ColorSystem.STANDARD])
CODE = re.compile(r"\x1b\[([0-9;]*)([mH])")


def seen(data: str) -> tuple[list[tuple[str, tuple]], tuple]:
    """Each printed character with its look, moves among them; and the look at the end."""
    look: dict[str, str] = {}
    cells = []
    at = 0
    while at < len(data):
        code = CODE.match(data, at)
        if code is None:
            moves = data[at] == "\n"
            cells.append((data[at], () if moves else tuple(sorted(look.items()))))
            at += 1
            continue
        at = code.end()
        if code[2] == "H":
            cells.append((code[0], ()))
            continue
        numbers = code[1].split(";")
        while numbers:
            n = numbers.pop(0) or "0"
            if n == "0":
                look = {}
            elif n in ("38", "48"):
                take = 4 if numbers[0] == "2" else 2
                look[n[0]] = ";".join(numbers[:take])
                del numbers[:take]
            elif n in ("39", "49"):
                look.pop(n[0], None)
            elif 30 <= int(n) <= 37 or 90 <= int(n) <= 97:
                look["3"] = n
            elif 40 <= int(n) <= 47 or 100 <= int(n) <= 107:
                look["4"] = n
            else:
                look[f"a{n}"] = n
    return cells, tuple(sorted(look.items()))


@given(RUNS, SYSTEMS)
def test_frugal_output_looks_the_same_and_is_no_longer(runs, system):
    data = "".join(style.render(text, color_system=system) for text, style in runs)
    assert seen(frugal(data)) == seen(data)
    assert len(frugal(data)) <= len(data)
    assert seen(frugal(data))[1] == ()  # plain at the end: anybody may write next


def test_a_row_of_an_image_costs_less_where_a_colour_stays():
    row = [Style(color="#a0b0c0", bgcolor=f"#0000{k:02x}") for k in range(0, 160, 8)]
    data = "".join(style.render("▀", color_system=ColorSystem.TRUECOLOR) for style in row)
    assert len(frugal(data)) < 0.55 * len(data)


def test_other_sequences_pass_untouched():
    for data in ("\x1b[?25l", "\x1b[>1u", "\x1b]52;c;eA==\a", "plain", ""):
        assert frugal(data) == data
