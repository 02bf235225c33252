"""The colours of the text client, by what they mean.

`dark` and `light` tell states apart by hue and lightness, and never by red against green alone;
what matters is said by a character as well. `mono` is for NO_COLOR: bold and reversed cells.
"""

import os
from collections.abc import Mapping
from functools import lru_cache
from typing import Literal

from rich.style import Style

Theme = Literal["dark", "light", "mono"]
Choice = Literal["auto", "dark", "light", "mono"]

_DARK = {
    "back": "#10141a",
    "text": "#c8d0d8",
    "bright": "#ffffff",
    "dim": "#8a97a6",
    "faint": "#5c6672",
    "axes": "#39424e",
    "border": "#33507a",
    "focus": "#8fb4e0",
    "name": "#7fa6d1",
    "good": "#7fd18b",
    "plausible": "#d9b35b",
    "ambiguous": "#d98a5b",
    "apart": "#a88fd1",
    "ellipse": "#5f7384",
    "waiting": "#f0e442",
    "outlier": "#d55e00",
    "red": "#b00020",
    "red cursor": "#e0263c",
    "red text": "#ff5050",
    "red border": "#7a2030",
    "red focus": "#ff3b4e",
    "on red": "#ffffff",
    "cursor": "#2f4f74",
    "step": "#1d3b5c",
    "on step": "#ffffff",
    "why": "#16202c",
    "on why": "#a9b8c8",
    "hint": "#f0e442",
    "on hint": "#000000",
}
_LIGHT = _DARK | {
    "back": "#f6f7f9",
    "text": "#1b232d",
    "bright": "#000000",
    "dim": "#56616e",
    "faint": "#8b95a1",
    "axes": "#c4ccd5",
    "border": "#9fb3cc",
    "focus": "#1f5fa8",
    "name": "#1f5fa8",
    "good": "#00694d",
    "plausible": "#8a5a00",
    "ambiguous": "#a33c00",
    "apart": "#6b3fa0",
    "ellipse": "#9aa9b8",
    "waiting": "#7a6a00",
    "outlier": "#b34700",
    "red text": "#b00020",
    "red border": "#d9a0a8",
    "red focus": "#b00020",
    "cursor": "#bcd3ee",
    "step": "#d5e4f5",
    "on step": "#0b2545",
    "why": "#e7ebf0",
    "on why": "#33404f",
}
_COLOURS: Mapping[Theme, Mapping[str, str]] = {
    "dark": _DARK,
    "light": _LIGHT,
    "mono": dict.fromkeys(_DARK, "default"),
}
_REVERSED = ("red", "red cursor", "cursor", "step", "hint")
_state: dict[str, Theme] = {"theme": "dark"}
_few = {"colours": False}


def use(theme: Theme) -> None:
    """Paints everything with a theme from now on."""
    _state["theme"] = theme
    style.cache_clear()


def theme() -> Theme:
    """The theme in use."""
    return _state["theme"]


def has(colour_system: str | None) -> None:
    """Tells how many colours the terminal has: `standard`, `256`, `truecolor`; none: not known."""
    _few["colours"] = colour_system == "standard"


def few_colours() -> bool:
    """Whether the terminal has no more than 16."""
    return _few["colours"]


def theme_for(choice: Choice, environment: Mapping[str, str] = os.environ) -> Theme:
    """What to use: `auto` heeds NO_COLOR, and COLORFGBG of terminals that tell their background."""
    if choice != "auto":
        return choice
    if environment.get("NO_COLOR"):
        return "mono"
    background = environment.get("COLORFGBG", "").rpartition(";")[2]
    return "light" if background in ("7", "15") else "dark"


def tone(role: str) -> str:
    """The colour of a role; a colour like #e69f00 is itself, but for `mono`."""
    if role.startswith("#"):
        return "default" if theme() == "mono" else role
    return _COLOURS[theme()][role]


def rgb(role: str) -> int:
    """A colour as 0xRRGGBB, for what is drawn into images; white in `mono`."""
    colour = tone(role)
    return 0xFFFFFF if colour == "default" else int(colour[1:], 16)


@lru_cache(maxsize=4096)
def style(front: str = "text", back: str = "back", bold: bool = False) -> Style:
    """A style with an explicit background: strips get none from their widget."""
    if theme() == "mono":
        shown = back in _REVERSED or back.startswith("#")
        return Style(color="default", bgcolor="default", bold=bold or shown, reverse=shown)
    return Style(color=tone(front), bgcolor=tone(back), bold=bold)


def variables() -> dict[str, str]:
    """The roles as variables of the style sheet."""
    shown = {f"fp-{role.replace(' ', '-')}": tone(role) for role in _DARK}
    return {name: "ansi_default" if c == "default" else c for name, c in shown.items()}
