"""The bars of the page, each a function from a bench to rows."""

from collections.abc import Callable
from typing import Any

from fleetpose.evaluation.system.web.bars.cost import cpu
from fleetpose.evaluation.system.web.bars.link import slow_link
from fleetpose.evaluation.system.web.bars.many import (
    IMAGES_HZ,
    POINTS,
    hour_of_images,
    thousand_points,
)
from fleetpose.evaluation.system.web.bars.newcomers import newcomers
from fleetpose.evaluation.system.web.bars.speed import shown_and_confirmed
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row

BARS: dict[int, Callable[[Bench], list[Row]]] = {
    1: shown_and_confirmed,
    3: cpu,
    4: slow_link,
    10: thousand_points,
    11: hour_of_images,
    13: newcomers,
}
SITES: dict[int, dict[str, Any]] = {10: {"points": POINTS}, 11: {"image_hz": IMAGES_HZ}}
"""What the site of a bar is other than usual, as `WebSite` takes it."""
