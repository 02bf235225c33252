"""Bar 4: how much state is sent, and what a link of 1 Mbit/s does to clicks and images."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bars.speed import Hand
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.probes import Probe
from fleetpose.evaluation.system.web.relay import SlowLink
from fleetpose.evaluation.system.web.rows import Row, at_most

STATE_KB_PER_S, LINK_BIT_PER_S, CONFIRMED_MS, AGE_S = 40.0, 1e6, 1000.0, 2.0
_STATE_KINDS = (2, 3)  # of binary frames: matrix and poses; images and clouds are not state
_WARM_MS = 3000


@dataclass
class Heard:
    """Bytes that a page hears of state."""

    state: int = 0

    def watch(self, page: Any) -> None:
        """Counts from now on; for a page that is not open yet."""
        page.on("websocket", lambda socket: socket.on("framereceived", self._take))

    def _take(self, frame: str | bytes) -> None:
        if isinstance(frame, str):
            self.state += len(frame.encode())
        elif frame[0] in _STATE_KINDS:
            self.state += len(frame)


def link(bench: Bench) -> list[Row]:
    """State by a free link, clicks and images by a slow one."""
    rows = [state(bench)]
    with SlowLink(bench.site.port, LINK_BIT_PER_S) as slow:
        page = bench.browser.page(bench.site.address(port=slow.port))
        hands.open_pair(page)
        hand, points = Hand(page), bench.many(25, 4)
        for k in range(points):
            bench.said(f"point {k + 1} of {points} by 1 Mbit/s")
            hand.point(by_key=False)
        late = percentile(hand.confirmed_ms, 95)
        rows.append(at_most(4, "click to confirmed by 1 Mbit/s, p95 ms", late, CONFIRMED_MS))
        bench.said("ages of images by 1 Mbit/s")
        ages = _ages(bench, page)
    return [*rows, at_most(4, "oldest image by 1 Mbit/s, s", max(ages, default=None), AGE_S)]


def state(bench: Bench) -> Row:
    """How much state a page hears while a pair is looked at."""
    heard = Heard()
    page = bench.browser.page(bench.site.address(), before=heard.watch)
    hands.open_pair(page)
    page.wait_for_timeout(_WARM_MS)
    seconds, heard.state = bench.many(20, 4), 0
    bench.said(f"{seconds} s of state")
    page.wait_for_timeout(1000 * seconds)
    page.context.close()
    return at_most(4, "state, kB/s", heard.state / 1000 / seconds, STATE_KB_PER_S)


def _ages(bench: Bench, slow: Any) -> list[float]:
    """How old images were when they were replaced: since another page of the same operator, with a
    free link, had drawn them.
    """
    fast = bench.browser.page(bench.site.address())
    of_fast, of_slow = Probe(fast), Probe(slow)
    fast.wait_for_timeout(_WARM_MS)
    of_slow.views()
    fast.wait_for_timeout(1000 * bench.many(30, 6))
    shown, drawn = of_slow.views(), of_fast.views()
    return [age for side in (0, 1) for age in ages_s(shown[side], drawn[side])]


def ages_s(shown: Sequence[tuple[int, float]], drawn: Sequence[tuple[int, float]]) -> list[float]:
    """How old each image of a slow page was when the next one replaced it.

    Args:
        shown: numbers of images, ascending, and when the slow page drew them, ms.
        drawn: the same of a quick page; of an image that it left out, the one before counts.
    """
    numbers, ages = [number for number, _ in drawn], []
    for (number, _), (_, replaced_ms) in pairwise(shown):
        k = bisect_right(numbers, number) - 1
        if k >= 0:
            ages.append((replaced_ms - drawn[k][1]) / 1000)
    return ages
