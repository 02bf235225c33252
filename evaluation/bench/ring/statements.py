"""What the method's paper says of its Figs. 9 and 10, asked of measured rings: yes or no, and the
figures.

The paper says three things: three clicks per pair reduce the position error drastically, whatever
the separation; more clicks reduce it only slightly further; ICP is faster where clicks give it a
better start. It names no limits. Those here are ours, and every answer names its own.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Column = Literal["position_error_m", "position_error_median_m", "icp_ms"]
Clicked = Mapping[int, float]
"""A measured value by number of clicks, at one separation."""

THREE = 3
DRASTIC = 0.5  # less than halved is not drastic by any reading
SLIGHT = 0.2  # of what three clicks took away: a fifth is still the smaller part by far
FASTER = 1.0
_SHORT = {"position_error_m": "mean", "position_error_median_m": "median"}


@dataclass(frozen=True)
class Statement:
    """One statement of the paper, and what the rings of one recipe say of it.

    Attributes:
        says: the statement.
        counts: what counts as yes.
        column: of the rings' table, which is asked.
        holds: whether the figure is below the limit; none where no ring has the clicks for it.
        figure: median over the separations of the share that the limit is for; infinite where an
            error is and stays without bound.
        limit: see the constants above.
        met, separations: at how many separations the share is below the limit, and of how many.
    """

    says: str
    counts: str
    column: Column
    holds: bool | None
    figure: float | None
    limit: float
    met: int
    separations: int

    @property
    def line(self) -> str:
        """The answer in one line."""
        if self.holds is None:
            return f"{self.says}: not asked, the clicks for it were not made"
        return (
            f"{self.says}: {'yes' if self.holds else 'no'} ({self.counts}; {self.figure:.2f}, "
            f"below {self.limit:g} at {self.met} of {self.separations})"
        )


def statements(rings: Sequence[Mapping[str, Any]]) -> tuple[Statement, ...]:
    """Asks the paper's three statements of one recipe's rings.

    The first two are asked of the mean error of all robots, as in the paper's Fig. 9, and of the
    median, since a single robot that is far off moves a mean. What counts as yes:

    - "drastically": the error with three clicks is below half of that with none.
    - "only slightly": more clicks than three change the error, up or down, by less than a fifth of
      what three had taken away. Where three took nothing away that is no.
    - "faster": ICP with three clicks takes less time than with none.

    Each is a share that is worked out at every separation; its median over the separations decides.
    At how many separations it is below the limit is told beside it: the paper says that three
    clicks help at all of them alike.

    Args:
        rings: `rings` of summary.json, one per separation and number of clicks. An error that is
            not there counts as infinite.
    """
    errors: tuple[Column, ...] = ("position_error_m", "position_error_median_m")
    return (
        *(_drastic(rings, column) for column in errors),
        *(_slight(rings, column) for column in errors),
        _faster(rings),
    )


def _drastic(rings: Sequence[Mapping[str, Any]], column: Column) -> Statement:
    return _statement(
        "three clicks reduce the error drastically",
        f"{_SHORT[column]} with three over none",
        column,
        [left(values) for values in _by_separation(rings, column)],
        DRASTIC,
    )


def _slight(rings: Sequence[Mapping[str, Any]], column: Column) -> Statement:
    return _statement(
        "more clicks change it only slightly",
        f"{_SHORT[column]}, change by more over what three took away",
        column,
        [moved(values) for values in _by_separation(rings, column)],
        SLIGHT,
    )


def _faster(rings: Sequence[Mapping[str, Any]]) -> Statement:
    return _statement(
        "ICP is faster with clicks",
        "ms with three over none",
        "icp_ms",
        [left(values) for values in _by_separation(rings, "icp_ms")],
        FASTER,
    )


def left(values: Clicked) -> float | None:
    """The share of a value without clicks that three clicks leave; 1 where both are infinite or
    both are nothing, none where one of them was not measured.
    """
    if not {0, THREE} <= set(values):
        return None
    none, three = values[0], values[THREE]
    if none == three:
        return 1.0
    if none == 0.0 or np.isinf(three):
        return np.inf
    return three / none


def moved(values: Clicked) -> float | None:
    """The largest change of a value by more than three clicks, as a share of what three had taken
    away; infinite where these took nothing, none where one of them was not measured.
    """
    more = [value for clicks, value in values.items() if clicks > THREE]
    if not more or not {0, THREE} <= set(values):
        return None
    none, three = values[0], values[THREE]
    if not three < none:
        return np.inf
    change = max(abs(value - three) for value in more)
    if np.isinf(none):
        return np.inf if np.isinf(change) else 0.0
    return change / (none - three)


def _statement(
    says: str, counts: str, column: Column, shares: Iterable[float | None], limit: float
) -> Statement:
    found = sorted(share for share in shares if share is not None)
    # of an even number the larger middle one: infinite ones have no mean, and no is the safer word
    figure = found[len(found) // 2] if found else None
    return Statement(
        says,
        counts,
        column,
        holds=None if figure is None else figure < limit,
        figure=figure,
        limit=limit,
        met=sum(share < limit for share in found),
        separations=len(found),
    )


def _by_separation(rings: Sequence[Mapping[str, Any]], column: Column) -> list[Clicked]:
    by_clicks: dict[float, dict[int, float]] = defaultdict(dict)
    for ring in rings:
        value = ring[column]
        by_clicks[ring["separation_deg"]][ring["clicks"]] = np.inf if value is None else value
    return list(by_clicks.values())
