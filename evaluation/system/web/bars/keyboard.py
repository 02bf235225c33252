"""Bar 5: without a pointer. A fleet in two pieces is joined by keys, and Tab leaves every panel."""

from typing import Any

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.rows import Row, at_least, at_most
from fleetpose.evaluation.system.web.states.fingers import PageFingers
from fleetpose.evaluation.system.web.states.pieces import PiecesSite

POINTS = 3
MOST_KEYS, MOST_KEYS_BY_HAND = 8, 36
JOINED_WITHIN_S = 20.0
PANELS = ("bar", "map", "scene", "matrix", "pair", "left", "right")
_TABS = 60
_FOCUSED = """() => {
    const at = document.activeElement;
    return at.closest('[data-panel]')?.dataset.panel ?? at.closest('section,header')?.id ?? '';
}"""


def without_a_pointer(bench: Bench) -> list[Row]:
    """Keys from the load of the page to the joined fleet, with suggestions and by hand."""
    page = bench.browser.page(bench.site.address())
    rows = _tab_leaves_every_panel(bench, page)
    page.context.close()
    bench.site.fleet.close()
    for by_hand, most in ((False, MOST_KEYS), (True, MOST_KEYS_BY_HAND)):
        rows += _joined(bench, by_hand, most)
    return rows


def _joined(bench: Bench, by_hand: bool, most: int) -> list[Row]:
    what = "by hand" if by_hand else "with suggestions"
    bench.said(f"a fleet in two pieces, {what}")
    with PiecesSite(bench.out / what.replace(" ", "_")) as site:
        page = bench.browser.page(site.address())
        fingers = PageFingers(page, site)
        fingers.answer(POINTS, by_hand)
        joined = site.is_joined(JOINED_WITHIN_S)
        page.wait_for_timeout(1000)
        bench.screenshot(page, f"joined_{what.replace(' ', '_')}")
        page.context.close()
    return [
        Row(5, f"fleet joined {what}", "yes" if joined else "no", "yes", joined),
        at_most(5, f"keys from load to the last point, {what}", fingers.keys, most),
    ]


def _tab_leaves_every_panel(bench: Bench, page: Any) -> list[Row]:
    """Tab goes through all panels and comes round."""
    hands.open_pair(page)
    seen: list[str] = []
    longest = run = 0
    for _ in range(_TABS):
        page.keyboard.press("Tab")
        seen.append(page.evaluate(_FOCUSED))
        run = run + 1 if len(seen) > 1 and seen[-1] == seen[-2] else 1
        longest = max(longest, run)
    reached = sum(any(panel in (at, {"list": "pair"}.get(at)) for at in seen) for panel in PANELS)
    return [
        at_least(5, f"panels of {len(PANELS)} that Tab reaches and leaves", reached, len(PANELS)),
        at_most(5, "Tabs at most within one panel", longest, _TABS // 4),
    ]
