"""Bars: a figure, its limit, and whether it is met; what a command prints, and how it ends."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from fleetpose.evaluation.report.output import print_table


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
    def row(self) -> tuple[str, float | None, str, str]:
        """Its line in a table."""
        said = (
            ("met" if self.met else "NOT MET") if self.checked else f"not checked: {self.why_not}"
        )
        return self.name, self.figure, f"{'>=' if self.at_least else '<='} {self.limit:g}", said


def all_met(bars: Sequence[Bar]) -> bool:
    """Whether all that were checked are met, and any was."""
    checked = [bar for bar in bars if bar.checked]
    return bool(checked) and all(bar.met for bar in checked)


def as_rows(bars: Sequence[Bar]) -> list[dict[str, Any]]:
    """For `summary.json`."""
    return [{**vars(bar), "met": bar.met if bar.checked else None} for bar in bars]


def print_bars(title: str, bars: Sequence[Bar]) -> None:
    """Prints each with its figure, its limit, and whether it is met."""
    print_table(title, ("bar", "figure", "limit", ""), [bar.row for bar in bars])
