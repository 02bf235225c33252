"""Bars: a figure, its limit, and whether it is met; what a command prints, and how it ends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Bar:
    """What is asked of a figure.

    Attributes:
        name: what was measured, with its unit.
        figure: what came out; None where it was not measured.
        limit: the most that it may be, or the least.
        at_least: whether the limit is the least.
        why_not: why it was not measured.
    """

    name: str
    figure: float | None
    limit: float
    at_least: bool = False
    why_not: str = ""

    @property
    def checked(self) -> bool:
        """Whether it was measured, or was to be."""
        return not self.why_not

    @property
    def met(self) -> bool:
        """Whether the figure is there and within its limit."""
        if self.figure is None or math.isnan(self.figure):
            return False
        return self.figure >= self.limit if self.at_least else self.figure <= self.limit

    @property
    def line(self) -> str:
        """As it is printed: whether it is met, figure, limit, name."""
        said = ("met" if self.met else "NOT MET") if self.checked else "not checked"
        figure = "-" if self.figure is None else f"{self.figure:.4g}"
        limit = f"{'>=' if self.at_least else '<='} {self.limit:g}"
        why = f" ({self.why_not})" if self.why_not else ""
        return f"{said:11}  {figure:>10}  {limit:>8}  {self.name}{why}"


def all_met(bars: Sequence[Bar]) -> bool:
    """Whether all that were checked are met, and any was."""
    checked = [bar for bar in bars if bar.checked]
    return bool(checked) and all(bar.met for bar in checked)


def as_rows(bars: Sequence[Bar]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [{**vars(bar), "met": bar.met if bar.checked else None} for bar in bars]


def print_bars(title: str, bars: Sequence[Bar]) -> None:
    """Prints each on a line, whole, whatever the terminal's width."""
    print(title)
    for bar in bars:
        print(f"  {bar.line}")
