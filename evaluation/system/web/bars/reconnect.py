"""Bar 7: what becomes of clicks when the bridge is killed, or when the server falls silent."""

import random
import time
from typing import Any

from fleetpose.evaluation.system.terminal.stand_in import HEIGHT, WIDTH
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.browser import became
from fleetpose.evaluation.system.web.rows import Row, at_most
from fleetpose.protocol.transport import wait_until

STATE_S, SAID_S = 1.0, 3.5
_KILLED_WITHIN_S = 0.06  # of the second half of a pick: sent, on its way, kept or receipted
_CONFIRMED_S = 10.0
_TRIES = 5
_HEARD = """async () => {
    // the moments, by the wall clock, at which each part of the state first came since `heard` was
    // emptied
    const { watch } = await import('/static/link/store.js');
    window.heard = {};
    for (const topic of ['step', 'list', 'poses'])
        watch([topic], () => {
            window.heard[topic] ??= performance.timeOrigin + performance.now();
        });
}"""
_PICKED = """async ([u, v]) => {
    const { state } = await import('/static/link/store.js');
    return state.list.points.some((p) => p.pi && p.pj && p.pi[0] === u && p.pi[1] === v);
}"""


def after_troubles(bench: Bench) -> list[Row]:
    """Bridges killed in the middle of clicks, then a server that is silent."""
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    page.evaluate(_HEARD)
    hand = _Hand(page, bench)
    for k in range(kills := bench.many(20, 4)):
        bench.said(f"bridge killed {k + 1} of {kills} times")
        hand.clicks_and_is_cut_off()
    rows = hand.rows(kills)
    bench.said("a silent server")
    return [*rows, *_silent_server(bench, page)]


class _Hand:
    """Picks points; each is a pixel of its own, so that lost and doubled ones can be told."""

    def __init__(self, page: Any, bench: Bench) -> None:
        self._page, self._bench, self._site = page, bench, bench.site
        self._chance = random.Random(0)
        self._meant: list[tuple[int, int]] = []
        self._back_s: list[float] = []
        self._again = 0

    def clicks_and_is_cut_off(self) -> None:
        """A point, whose second click the bridge does not survive; picked again where the page,
        once it is back, does not show it.
        """
        target = self._target()
        self._meant.append(target)
        self._first_half(target)
        self._page.keyboard.press("Space")
        time.sleep(self._chance.uniform(0, _KILLED_WITHIN_S))
        self._site.kill_bridge()
        self._page.evaluate("() => { window.heard = {}; }")
        self._site.start_bridge()
        listens_ms = 1000 * time.time()
        complete = "() => Object.keys(window.heard).length === 3"
        back = became(self._page, complete, timeout_s=10.0)
        newest_ms = max(self._page.evaluate("() => Object.values(window.heard)"), default=1e15)
        self._back_s.append((newest_ms - listens_ms) / 1000 if back else float("inf"))
        self._until_there(target)

    def _until_there(self, target: tuple[int, int]) -> None:
        """Looks at the list, as an operator does, and picks again what is not in it."""
        hands.wait_knows(self._page, "state.images[0] && state.images[1] && state.list.pair")
        for _ in range(_TRIES):
            if became(self._page, _PICKED, list(target), timeout_s=2.0):
                break
            self._again += 1
            self._first_half(target)
            self._page.keyboard.press("Space")
        wait_until(lambda: target in self._received(), _CONFIRMED_S)

    def _first_half(self, target: tuple[int, int]) -> None:
        """The left half by a key; the right cross stays where it is."""
        u, v = target
        self._page.evaluate(
            "async ([u, v]) => (await import('/static/link/commands.js')).moveCursor(0, [u, v])",
            [u, v],
        )
        self._page.keyboard.press("Space")
        hands.wait_knows(self._page, "state.list.half && state.active === 1")

    def _target(self) -> tuple[int, int]:
        return self._chance.randrange(20, WIDTH - 20), self._chance.randrange(20, HEIGHT - 20)

    def _received(self) -> list[tuple[int, int]]:
        adds = [one for one in self._site.received() if one["action"] == "add"]
        return [(round(one["pixel_i"][0]), round(one["pixel_i"][1])) for one in adds]

    def rows(self, kills: int) -> list[Row]:
        """What became of it."""
        got = self._received()
        lost = sum(target not in got for target in self._meant)
        doubled = sum(got.count(target) > 1 for target in set(self._meant))
        return [
            at_most(7, f"clicks lost, bridge killed {kills} times in mid-click", lost, 0),
            at_most(7, "clicks doubled", doubled, 0),
            at_most(7, "clicks that the page showed as dropped, picked again", self._again, kills),
            at_most(7, "state after the bridge listens, slowest, s", max(self._back_s), STATE_S),
        ]


def _silent_server(bench: Bench, page: Any) -> list[Row]:
    """The server stops in the middle of work; two clicks later the page says so, with their count.

    The two halves of a point are one click that is kept.
    """
    before = len(bench.site.received())
    bench.site.silence_server(True)
    began_s = time.monotonic()
    hands.pick_by_keys(page, 2)
    says = "() => /nothing heard|no server/i.test(document.querySelector('#bar h1').textContent)"
    said = became(page, says, timeout_s=10.0)
    took_s = time.monotonic() - began_s if said else None
    counted = "() => /\\b2 clicks (are )?kept/.test(document.querySelector('#bar').innerText)"
    kept = became(page, counted, timeout_s=3.0)
    bench.screenshot(page, "silent")
    bench.site.silence_server(False)
    came = wait_until(lambda: len(bench.site.received()) == before + 2, _CONFIRMED_S)
    return [
        at_most(7, "silent server is said, s", took_s, SAID_S),
        Row(7, "both clicks counted as kept", "yes" if kept else "no", "yes", kept),
        Row(7, "both clicks arrive when it is back", "yes" if came else "no", "yes", came),
    ]
