"""Bars 10 and 11: a thousand points, and an hour of images."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Any

from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bars.speed import SHOWN_MS, Hand
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row, at_most
from fleetpose.protocol.errors import FleetPoseError

POINTS, IMAGES_HZ = 1000, 100.0
RSS_PERCENT, BRIDGE_MB = 5.0, 3.0
_SAMPLES = 80
_STOPPED_S = 20.0


def thousand_points(bench: Bench) -> list[Row]:
    """Keys while images are held in which a thousand points lie."""
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    page.keyboard.press("f")
    hands.wait_knows(page, f"state.list.points.filter((p) => !p.other_view).length >= {POINTS}")
    hand, turns = Hand(page), bench.many(40, 6)
    for k in range(turns):
        bench.said(f"keys {k + 1} of {turns}")
        for _ in range(3):
            hand.nudge(0)
        hand.pick(0, by_key=True)
        page.keyboard.press("Escape")
        hands.wait_knows(page, "!state.list.half")
        hand.activate(0)
    bench.screenshot(page, "points")
    name = f"key to shown with {POINTS} points, p95 ms"
    return [at_most(10, name, percentile(hand.key_ms, 95), SHOWN_MS)]


@dataclass(frozen=True)
class Sample:
    """Memory after so many images, in bytes."""

    images: int
    renderer: int
    bridge: int
    heap: int


def hour_of_images(bench: Bench) -> list[Row]:
    """Memory while images come as fast as they are acknowledged."""
    images = min(bench.options.images, 300) if bench.options.quick else bench.options.images
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    meter = page.context.new_cdp_session(page)
    hands.count_images(page)
    _wait_images(page, images // 20)
    first = hands.images_seen(page)
    samples: list[Sample] = []
    for k in range(_SAMPLES):
        bench.said(f"{hands.images_seen(page)} of {images} images")
        samples.append(_sample(bench, page, meter))
        _wait_images(page, first + (k + 1) * images // _SAMPLES)
    return grown(samples, images)


def grown(samples: Sequence[Sample], images: int) -> list[Row]:
    """Rows of how much memory grew, each by medians of quarters."""
    quarter = len(samples) // 4

    def median(what: str, which: int) -> float:
        part = samples[which * quarter : (which + 1) * quarter]
        return statistics.median(getattr(sample, what) for sample in part)

    renderer = 100 * (median("renderer", 3) / median("renderer", 0) - 1)
    bridge = (median("bridge", 3) - median("bridge", 0)) / 1e6
    heap = [round(median("heap", k) / 1e6, 1) for k in (1, 3)]
    of = f"of {images} images"
    return [
        at_most(11, f"renderer's memory grows {of}, %", renderer, RSS_PERCENT),
        at_most(11, f"bridge's memory grows {of}, MB", bridge, BRIDGE_MB),
        at_most(11, f"heap {of}: the last quarter beside the second, MB", heap[1], heap[0]),
    ]


def _sample(bench: Bench, page: Any, meter: Any) -> Sample:
    meter.send("HeapProfiler.collectGarbage")
    heap = int(meter.send("Runtime.getHeapUsage")["usedSize"])
    seen = hands.images_seen(page)
    return Sample(seen, bench.browser.renderer_rss(), bench.site.bridge_rss(), heap)


def _wait_images(page: Any, count: int) -> None:
    """Until the page has drawn so many.

    Raises:
        FleetPoseError: no more come.
    """
    seen, since_s = -1, monotonic()
    while (now := hands.images_seen(page)) < count:
        if now > seen:
            seen, since_s = now, monotonic()
        if monotonic() - since_s > _STOPPED_S:
            raise FleetPoseError(f"no image for {_STOPPED_S:.0f} s, after {seen} of {count}")
        page.wait_for_timeout(200)
