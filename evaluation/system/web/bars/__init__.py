"""The bars of the page, each a function from a bench to rows."""

from collections.abc import Callable
from typing import Any

from fleetpose.evaluation.system.web.bars.cost import cpu
from fleetpose.evaluation.system.web.bars.gate import who_is_let_in
from fleetpose.evaluation.system.web.bars.keyboard import without_a_pointer
from fleetpose.evaluation.system.web.bars.link import slow_link
from fleetpose.evaluation.system.web.bars.many import (
    IMAGES_HZ,
    POINTS,
    hour_of_images,
    thousand_points,
)
from fleetpose.evaluation.system.web.bars.newcomers import newcomers
from fleetpose.evaluation.system.web.bars.operators import side_by_side
from fleetpose.evaluation.system.web.bars.picks import exactly_picked
from fleetpose.evaluation.system.web.bars.reconnect import after_troubles
from fleetpose.evaluation.system.web.bars.speed import shown_and_confirmed
from fleetpose.evaluation.system.web.bars.states import as_it_is_told, how_it_looks
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row

BARS: dict[int, Callable[[Bench], list[Row]]] = {
    1: shown_and_confirmed,
    2: exactly_picked,
    3: cpu,
    4: slow_link,
    5: without_a_pointer,
    6: how_it_looks,
    7: after_troubles,
    8: side_by_side,
    9: who_is_let_in,
    10: thousand_points,
    11: hour_of_images,
    12: as_it_is_told,
    13: newcomers,
}
SITES: dict[int, dict[str, Any]] = {10: {"points": POINTS}, 11: {"image_hz": IMAGES_HZ}}
"""What the site of a bar is other than usual, as `WebSite` takes it."""
