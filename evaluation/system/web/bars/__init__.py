"""The bars of the page, each a function from a bench to rows."""

from collections.abc import Callable

from fleetpose.evaluation.system.web.bars.speed import shown_and_confirmed
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row

BARS: dict[int, Callable[[Bench], list[Row]]] = {
    1: shown_and_confirmed,
}
