"""The colours of the text client, by what they mean: those of `desk.colours`, as styles.

`mono` is for NO_COLOR: bold and reversed cells.
"""

import os
from collections.abc import Mapping
from functools import lru_cache
from typing import Literal

from rich.style import Style

from fleetpose.hmi_client.desk.colours import ROLES

Theme = Literal["dark", "light", "mono"]
Choice = Literal["auto", "dark", "light", "mono"]

_COLOURS: Mapping[Theme, Mapping[str, str]] = {
    "dark": ROLES["dark"],
    "light": ROLES["light"],
    "mono": dict.fromkeys(ROLES["dark"], "default"),
}
_REVERSED = ("red", "red cursor", "cursor", "step", "warn", "hint")
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
    shown = {f"fp-{role.replace(' ', '-')}": tone(role) for role in ROLES["dark"]}
    return {name: "ansi_default" if c == "default" else c for name, c in shown.items()}
