"""Bar 8: two operators. Each sees the other's pair, and one of two contrary deeds wins."""

import time
from typing import Any

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.browser import became
from fleetpose.evaluation.system.web.rows import Row, at_most
from fleetpose.evaluation.system.web.states.fingers import PageFingers
from fleetpose.evaluation.system.web.states.pieces import PiecesSite

SEEN_S = 1.0
_DECIDED_S = 10.0
_SHOWN = "(words) => document.querySelector('#who').innerText.includes(words)"
_REASON = "somebody has {} it meanwhile"
_READS = "(words) => document.body.innerText.includes(words)"


def side_by_side(bench: Bench) -> list[Row]:
    """Two browsers, first at pairs of their own, then at the same point."""
    rows = _each_sees_the_other(bench)
    bench.site.fleet.close()
    return [*rows, *_erase_against_move(bench)]


def _each_sees_the_other(bench: Bench) -> list[Row]:
    """How long until a page names the other operator and his pair, be it the same or another."""
    names = ("kim", "ana")
    pages = [bench.browser.page(bench.site.address(name)) for name in names]
    for page in pages:
        hands.wait_knows(page, "state.names.length > 8")
    took = []
    pairs = (("r1", "r2"), ("r2", "r3"), ("r4", "r6"), ("r1", "r2"))
    for k, (a, b) in enumerate(pairs * bench.many(3, 1)):
        mine, others = pages[k % 2], pages[1 - k % 2]
        began_s = time.monotonic()
        mine.evaluate(hands.RUN, ["select", {"a": a, "b": b}])
        seen = became(others, _SHOWN, f"{names[k % 2]} at {a} – {b}", timeout_s=5.0)
        took.append(time.monotonic() - began_s if seen else float("inf"))
    bench.screenshot(pages[0], "two_operators")
    for page in pages:
        page.context.close()
    return [at_most(8, "other operator's pair shown, slowest, s", max(took), SEEN_S)]


def _erase_against_move(bench: Bench) -> list[Row]:
    """Kim erases a point in the moment in which Ana moves it, at a real server."""
    rows = []
    bench.said("a real fleet")
    with PiecesSite(bench.out / "pieces") as site:
        kim, ana = (bench.browser.page(site.address(name)) for name in ("kim", "ana"))
        fingers = PageFingers(kim, site)
        pair = fingers.answer(2, by_hand=True)
        ana.evaluate(hands.RUN, ["select", dict(zip("ab", pair, strict=True))])
        hands.wait_knows(ana, "state.list.points.filter((p) => p.id !== null).length >= 2")
        for first in ("erase", "move"):
            bench.said(f"erase against move, {first} first")
            rows += _contend(bench, kim, ana, first)
    return rows


def _contend(bench: Bench, kim: Any, ana: Any, first: str) -> list[Row]:
    """Both act before either has heard of the other; the server's order decides."""
    point = hands.knows(kim, "list.points.0")
    ana.evaluate(hands.RUN, ["show", {"id": point["id"]}])
    hands.wait_knows(ana, f"state.list.points.some((p) => p.id === {point['id']} && !p.other_view)")
    to = [point["pj"][0] + 20, point["pj"][1]]
    deeds = [
        (kim, ["erase", {"id": point["id"]}]),
        (ana, ["move", {"id": point["id"], "side": 1, "pixel": to}]),
    ]
    for page, deed in deeds if first == "erase" else deeds[::-1]:
        page.evaluate(hands.RUN, deed)
    for page in (kim, ana):
        hands.wait_knows(page, "state.health.unconfirmed === 0", _DECIDED_S)
        page.wait_for_timeout(500)
    left = [_points(page) for page in (kim, ana)]
    erased = point["id"] not in left[0]
    moved = not erased and left[0][point["id"]] == to
    reason = _REASON.format("erased" if erased else "moved")
    loser = ana if erased else kim
    reads = became(loser, _READS, reason, timeout_s=3.0)
    for name, page in (("kim", kim), ("ana", ana)):
        bench.screenshot(page, f"{first}_first_{name}")
    one = left[0] == left[1] and (erased or moved)
    return [
        Row(8, f"one wins on both pages, {first} first", "yes" if one else "no", "yes", one),
        Row(8, f"the other reads why, {first} first", "yes" if reads else "no", "yes", reads),
    ]


def _points(page: Any) -> dict[int, list[float]]:
    """Where the points that the server has are in the second image, by their ids."""
    points = hands.knows(page, "list.points")
    return {point["id"]: point["pj"] for point in points if point["id"] is not None}
