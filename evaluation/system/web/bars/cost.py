"""Bar 3: what bridge and page cost while images come at 5 Hz."""

from time import monotonic

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row, at_most

BRIDGE_PERCENT, PER_OPERATOR_PERCENT, PAGE_PERCENT = 12.0, 8.0, 25.0
_WARM_MS = 4000


def cpu(bench: Bench) -> list[Row]:
    """Shares of a core, with one operator and with two; the page is the whole browser."""
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    page.wait_for_timeout(_WARM_MS)
    bridge, browser = _shares(bench, page)
    other = bench.browser.page(bench.site.address("ana"))
    hands.open_pair(other)
    page.wait_for_timeout(_WARM_MS)
    both, _ = _shares(bench, page)
    two = BRIDGE_PERCENT + PER_OPERATOR_PERCENT
    return [
        at_most(3, "bridge with one operator, % of a core", bridge, BRIDGE_PERCENT),
        at_most(3, "bridge with two operators, % of a core", both, two),
        at_most(3, "page with all of its browser, % of a core", browser, PAGE_PERCENT),
    ]


def _shares(bench: Bench, page: object) -> tuple[float, float]:
    """Percent of a core of the bridge and of the browser."""
    seconds = bench.many(30, 4)
    bench.said(f"{seconds} s of images")
    began_s = monotonic()
    bridge_s, browser_s = bench.site.bridge_cpu_s(), bench.browser.cpu_s()
    page.wait_for_timeout(1000 * seconds)  # pyright: ignore[reportAttributeAccessIssue]
    took_s = monotonic() - began_s
    bridge_s, browser_s = bench.site.bridge_cpu_s() - bridge_s, bench.browser.cpu_s() - browser_s
    return 100 * bridge_s / took_s, 100 * browser_s / took_s
