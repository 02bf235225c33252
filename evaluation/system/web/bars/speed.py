"""Bar 1: how soon a click or a key is shown, and confirmed."""

import random
from typing import Any

from fleetpose.evaluation.metrics.scoring import percentile
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.probes import Probe
from fleetpose.evaluation.system.web.rows import Row, at_most

SHOWN_MS, CONFIRMED_MS, CONFIRMED_LATE_MS, GAP_S = 50.0, 60.0, 250.0, 0.5
LOST_MS = 10_000.0  # stands for what never came
_PAUSE_MS = (50, 250)  # of a hand between two clicks, and so that they fall anywhere in a turn
_CENTRE, _REACH = 0.5, 0.35  # of a loupe: shares of its size


class Hand:
    """Picks points at places drawn by chance, and keeps how long each took to be seen."""

    def __init__(self, page: Any, seed: int = 0) -> None:
        self.page, self.probe = page, Probe(page)
        self._chance = random.Random(seed)
        self.click_ms: list[float] = []
        self.key_ms: list[float] = []
        self.confirmed_ms: list[float] = []

    def point(self, by_key: bool) -> None:
        """A point: its halves left and right, until it is confirmed."""
        for side in (0, 1):
            self._to_place(side)
            self.pick(side, by_key)
        took_ms = self.probe.confirmed_ms()
        self.confirmed_ms.append(LOST_MS if took_ms is None else took_ms)
        self._pause()

    def nudge(self, side: int) -> None:
        """An arrow key, whose effect is the loupe's picture."""
        self.probe.arm("move", "keydown", side)
        self.page.keyboard.press(self._chance.choice(("ArrowLeft", "ArrowRight")))
        self._note(self.key_ms)

    def activate(self, side: int) -> None:
        """Makes a side the one that keys work at, without moving its cross."""
        self.page.keyboard.press("45"[side])
        hands.wait_knows(self.page, f"state.active === {side}")

    def _to_place(self, side: int) -> None:
        self.probe.arm("move", "pointerup", side)
        hands.click_image(self.page, side, *self._anywhere())
        self._note(self.click_ms)
        self._pause()

    def pick(self, side: int, by_key: bool) -> None:
        """Half a point, until it is drawn."""
        self.probe.arm("mark", "keydown" if by_key else "pointerup", side)
        if by_key:
            self.page.keyboard.press("Space")
        else:
            hands.click_loupe(self.page, side, *self._anywhere())
        self._note(self.key_ms if by_key else self.click_ms)

    def _anywhere(self) -> tuple[float, float]:
        low, high = _CENTRE - _REACH, _CENTRE + _REACH
        return self._chance.uniform(low, high), self._chance.uniform(low, high)

    def _note(self, times: list[float]) -> None:
        took_ms = self.probe.shown_ms()
        times.append(LOST_MS if took_ms is None else took_ms)

    def _pause(self) -> None:
        self.page.wait_for_timeout(self._chance.uniform(*_PAUSE_MS))


def shown_and_confirmed(bench: Bench) -> list[Row]:
    """Clicks and keys of one operator, and the images of another meanwhile."""
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    hand = Hand(page)
    points = bench.many(50, 6)
    for k in range(points):
        bench.said(f"point {k + 1} of {points}")
        hand.point(by_key=bool(k % 2))
        hand.nudge(0)  # the page has turned to the left image
    bench.screenshot(page, "clicked")
    rows = [
        at_most(1, "click to shown, p95 ms", percentile(hand.click_ms, 95), SHOWN_MS),
        at_most(1, "key to shown, p95 ms", percentile(hand.key_ms, 95), SHOWN_MS),
        at_most(1, "click to confirmed, p50 ms", percentile(hand.confirmed_ms, 50), CONFIRMED_MS),
        at_most(
            1, "click to confirmed, p95 ms", percentile(hand.confirmed_ms, 95), CONFIRMED_LATE_MS
        ),
    ]
    return [*rows, _gap_of_another(bench, hand)]


def _gap_of_another(bench: Bench, hand: Hand) -> Row:
    """How long another operator's images stand still while expected places are worked out."""
    other = bench.browser.page(bench.site.address("ana"))
    hands.open_pair(other)
    watched = Probe(other)
    other.wait_for_timeout(1000)
    watched.gaps_s()
    for _ in range(bench.many(20, 4)):
        bench.said("expected places beside another operator")
        hand.point(by_key=False)
    gaps = watched.gaps_s()
    return at_most(1, "another operator's longest image gap, s", max(gaps, default=None), GAP_S)
