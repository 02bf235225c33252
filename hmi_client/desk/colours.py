"""Colours by what they mean, for screens and pages.

`dark` and `light` tell states apart by hue and lightness, and never by red against green alone;
what matters is said by a character as well. What is written has a contrast of 4.5 at least.
"""

from collections.abc import Mapping
from typing import Literal

Theme = Literal["dark", "light"]

# The palette of Okabe and Ito is told apart by colour-blind people; the numbers say the same.
MARKER_COLOURS = (
    *("#e69f00", "#56b4e9", "#009e73", "#f0e442"),
    *("#5a9bd4", "#d55e00", "#cc79a7", "#ffffff"),
)
_DARK = {
    "back": "#10141a",
    "text": "#c8d0d8",
    "bright": "#ffffff",
    "dim": "#93a0af",
    "faint": "#7b8692",
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
    "outlier": "#f08a3c",
    "red": "#b00020",
    "red cursor": "#d31f36",
    "red text": "#ff5050",
    "red border": "#7a2030",
    "red focus": "#ff3b4e",
    "on red": "#ffffff",
    "cursor": "#1d3349",
    "step": "#1d3b5c",
    "on step": "#ffffff",
    "warn": "#5a3208",
    "on warn": "#ffe3c4",
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
    "faint": "#667180",
    "axes": "#c4ccd5",
    "border": "#9fb3cc",
    "focus": "#1f5fa8",
    "name": "#1f5fa8",
    "good": "#00694d",
    "plausible": "#7d5200",
    "ambiguous": "#963700",
    "apart": "#6b3fa0",
    "ellipse": "#9aa9b8",
    "waiting": "#6b5d00",
    "outlier": "#a84300",
    "red cursor": "#d31f36",
    "red text": "#b00020",
    "red border": "#d9a0a8",
    "red focus": "#b00020",
    "cursor": "#d3e2f4",
    "step": "#d5e4f5",
    "on step": "#0b2545",
    "warn": "#ffe3c4",
    "on warn": "#4a2600",
    "why": "#e7ebf0",
    "on why": "#33404f",
}
ROLES: Mapping[Theme, Mapping[str, str]] = {"dark": _DARK, "light": _LIGHT}
WRITTEN: tuple[tuple[str, str], ...] = (
    *(
        (role, "back")
        for role in (
            *("text", "bright", "dim", "faint", "focus", "name", "good", "plausible"),
            *("ambiguous", "apart", "waiting", "outlier", "red text"),
        )
    ),
    *((role, "cursor") for role in ("text", "bright", "dim", "good", "outlier", "plausible")),
    *(("on step", "step"), ("on warn", "warn"), ("on why", "why"), ("focus", "why")),
    *(("dim", "why"), ("waiting", "why"), ("on red", "red"), ("on red", "red cursor")),
    ("on hint", "hint"),
)
"""Which roles are written on which."""


def marker_colour(number: int) -> str:
    """The colour of the n-th correspondence, from 1."""
    return MARKER_COLOURS[(number - 1) % len(MARKER_COLOURS)]


def contrast(front: str, back: str) -> float:
    """Of two colours #rrggbb: 1 to 21, by WCAG 2."""
    lighter, darker = sorted((_luminance(front), _luminance(back)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


def _luminance(colour: str) -> float:
    parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
