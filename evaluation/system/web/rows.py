"""A bar of the page as a row: what was measured, what it may be, and whether it is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A bar's figure beside its limit.

    Attributes:
        bar: its number.
        name: what was measured, with its unit.
        value: what came out; where it could not be measured, why.
        limit: as it is printed.
        met: whether the figure is within its limit; None where it could not be measured.
    """

    bar: int
    name: str
    value: float | str
    limit: str
    met: bool | None

    @property
    def said(self) -> str:
        """Whether it is met, in words."""
        return {True: "met", False: "NOT MET", None: "not measured"}[self.met]


def at_most(bar: int, name: str, value: float | None, limit: float) -> Row:
    """A figure that may not be larger; one that is not there, or not a number, misses."""
    shown = math.nan if value is None else float(value)
    return Row(bar, name, shown, f"<= {limit:g}", shown <= limit)


def at_least(bar: int, name: str, value: float | None, limit: float) -> Row:
    """A figure that may not be smaller; one that is not there, or not a number, misses."""
    shown = math.nan if value is None else float(value)
    return Row(bar, name, shown, f">= {limit:g}", shown >= limit)


def unmeasured(bar: int, name: str, why: str) -> Row:
    """A bar that could not be measured; it never counts as met."""
    return Row(bar, name, why, "-", None)


def all_met(rows: Sequence[Row]) -> bool:
    """Whether there are rows, and each is met."""
    return bool(rows) and all(row.met is True for row in rows)
