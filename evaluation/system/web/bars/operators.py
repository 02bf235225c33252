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
_READS = """(n) => {
    const said = ['#bar', '#notice', '#events', '#pair'].map((id) => document.querySelector(id));
    const words = said.map((node) => node.innerText).join(' ');
    return /refused|erased|no longer|not there|has gone|unknown/i.test(words) ? words : '';
}"""


def side_by_side(bench: Bench) -> list[Row]:
    """Two browsers, first at pairs of their own, then at the same point."""
    rows = _each_sees_the_other(bench)
    bench.site.fleet.close()
    return [*rows, *_erase_against_move(bench)]


def _each_sees_the_other(bench: Bench) -> list[Row]:
    """How long until a page names the other operator and his pair, also where it is another pair."""
    names = ("kim", "ana")
    pages = [bench.browser.page(bench.site.address(name)) for name in names]
    for page in pages:
        hands.wait_knows(page, "state.names.length > 8")
    took = []
    pairs = (("r1", "r2"), ("r2", "r3"), ("r4", "r6"), ("r1", "r2"))
    for k, (a, b) in enumerate(pairs * bench.many(3, 1)):
        mine, others = pages[k % 2], pages[1 - k % 2]
        began_s = time.monotonic()
        mine.evaluate(_SELECT, [a, b])
        seen = became(others, _SHOWN, f"{names[k % 2]} at {a} – {b}", timeout_s=5.0)
        took.append(time.monotonic() - began_s if seen else float("inf"))
    bench.screenshot(pages[0], "two_operators")
    for page in pages:
        page.context.close()
    return [at_most(8, "other operator's pair shown, slowest, s", max(took), SEEN_S)]


_SELECT = """async ([a, b]) =>
    (await import('/static/link/commands.js')).run('select', { a, b })"""


def _erase_against_move(bench: Bench) -> list[Row]:
    """Kim erases a point in the moment in which Ana moves it, at a real server."""
    rows = []
    bench.said("a real fleet")
    with PiecesSite(bench.out / "pieces") as site:
        kim, ana = (bench.browser.page(site.address(name)) for name in ("kim", "ana"))
        fingers = PageFingers(kim, site)
        pair = fingers.answer(2, by_hand=True)
        ana.evaluate(_SELECT, list(pair))
        hands.wait_knows(ana, "state.list.points.filter((p) => p.id !== null).length >= 2")
        for k, first in enumerate(("erase", "move")):
            bench.said(f"erase against move, {first} first")
            rows += _contend(bench, kim, ana, k, first)
    return rows


def _contend(bench: Bench, kim: Any, ana: Any, k: int, first: str) -> list[Row]:
    point = hands.knows(kim, "list.points.0")
    ana.evaluate(_RUN, ["show", {"id": point["id"]}])
    hands.wait_knows(ana, "state.list.points.some((p) => p.id !== null && !p.other_view)")
    move = {"id": point["id"], "side": 1, "pixel": [point["pj"][0] + 20, point["pj"][1]]}
    deeds = [(kim, ["erase", {"id": point["id"]}]), (ana, ["move", move])]
    for page, deed in deeds if first == "erase" else deeds[::-1]:
        page.evaluate(_RUN, deed)
    gone = f"!state.list.points.some((p) => p.id === {point['id']} && p.status !== 'rejected')"
    hands.wait_knows(kim, "state.health.unconfirmed === 0", _DECIDED_S)
    hands.wait_knows(ana, "state.health.unconfirmed === 0", _DECIDED_S)
    time.sleep(1.0)
    bench.screenshot(kim, f"contended_{k}_kim")
    bench.screenshot(ana, f"contended_{k}_ana")
    lists = [hands.knows(page, "list.points") for page in (kim, ana)]
    same = [sorted(p["pi"] for p in one if p["id"] is not None) for one in lists]
    print(first, gone, lists, [page.evaluate(_READS, 0) for page in (kim, ana)])
    return [
        Row(
            8,
            f"both pages agree, {first} first",
            str(same[0] == same[1]),
            "True",
            same[0] == same[1],
        ),
    ]


_RUN = "async ([id, args]) => (await import('/static/link/commands.js')).run(id, args)"
