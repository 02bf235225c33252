"""A simulated operator who has a keyboard and no pointer: sees what the page shows, knows what two
pixels show, and presses keys.
"""

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.system.terminal.fingers import Place, arrow_keys
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.states.pieces import PiecesSite
from fleetpose.protocol.errors import FleetPoseError

SAME_PX = 1.5  # nearer than that nobody corrects by hand
CORRECTED_KEYS = 1  # a suggestion that is off is corrected if that many keys do it
LABEL_KEYS = 3  # of `g` and the two letters of a label
APART_PX = 60.0  # points that are nearer to each other tell little more
READ_MS = (
    500  # nobody presses a button sooner after its words have changed, nor does the page take it
)
GUESS_S = 3.0  # as long an operator waits for the place that is expected
_SUGGESTED = "state.assist.suggestion"


class PageFingers:
    """Answers the first question. `keys` counts what was pressed since the page was loaded.

    Args:
        page: connected.
        site: whose eyes are behind the fingers.
    """

    def __init__(self, page: Any, site: PiecesSite) -> None:
        self._page, self._site = page, site
        self.keys, self.suggested = 0, 0
        self.picked: list[Floats] = []

    def press(self, *keys: str) -> None:
        """Presses keys, named as `arrow_keys` does or as the browser does."""
        for key in keys:
            self.keys += 1
            self._page.keyboard.press(_named(key))

    def answer(self, points: int, by_hand: bool) -> tuple[str, str]:
        """Goes to the first question and picks so many points; returns its robots.

        Args:
            points: how many.
            by_hand: do without suggestions.

        Raises:
            FleetPoseError: the suggestions, or the labels, are not enough.
        """
        hands.wait_knows(self._page, "state.questions.length > 0")
        self.press("n")
        hands.wait_knows(
            self._page, "state.list.pair && state.images[0] && state.images[1] && state.cursors[0]"
        )
        first, second = self._knows("list.pair")
        self.eyes = self._site.eyes((first, second))
        if not by_hand:
            self._by_suggestions(points)
        while len(self.picked) < points:
            self.by_hand()
        return first, second

    # ---- suggestions -----------------------------------------------------------------------------

    def _by_suggestions(self, points: int) -> None:
        self._page.wait_for_timeout(READ_MS)
        self.press("Enter")  # what the bar's first button does
        self._wait(_SUGGESTED)
        while len(self.picked) < points:
            n = self._knows("assist.suggestion.n")
            left, right = self._cursors()
            where = self._partner(left)
            keys = None if where is None else arrow_keys(*(where - right))
            if self.eyes.same(tuple(left.tolist()), tuple(right.tolist())):
                keys = []
            if keys is None or len(keys) > CORRECTED_KEYS or not self._is_apart(left):
                self.press("Shift+Tab")
            else:
                self.press(*keys, "Tab")
                self.picked.append(left)
                self.suggested += 1
            self._wait(f"{_SUGGESTED}?.n !== {n}")
            if self._knows("assist.suggestion") is None:
                return

    # ---- by hand ---------------------------------------------------------------------------------

    def by_hand(self, off_px: float = 0.0) -> None:
        """One point: a label in the left image, then what is expected in the right one, corrected
        from there or from the nearest label.

        Args:
            off_px: how far to the right of its place the second half is picked by mistake.
        """
        where = self.half() + np.array((off_px, 0.0))
        if len(self._off(where)) > LABEL_KEYS:
            self._go(lambda place: -float(np.linalg.norm(where - place)))
        self.press(*self._off(where), "Space")
        self._wait(f"state.list.points.filter((p) => p.id !== null).length >= {len(self.picked)}")

    def half(self) -> Floats:
        """The left half of a point; returns where the right image shows it, (2,)."""
        if self._knows("active") != 0:
            self.press("4")
        where = self._go_where_both_see()
        self.press("Space")
        self._wait("state.list.half && state.active === 1")
        with contextlib.suppress(FleetPoseError):  # there may be none
            hands.wait_knows(self._page, "state.assist.expected", GUESS_S)
        return where

    def _off(self, where: Floats) -> list[str]:
        """The arrows that bring the right cross there."""
        off = where - self._cursors()[1]
        return arrow_keys(*off) if np.linalg.norm(off) > SAME_PX else []

    def _go_where_both_see(self) -> Floats:
        """Goes to a place of the left image and returns where the right one shows it, (2,)."""
        vain: list[Floats] = []
        while len(vain) < 3:
            pixel = self._go(lambda place: self._worth(place, vain))
            where = self._partner(pixel)
            if where is not None:
                self.picked.append(pixel)
                return where
            vain.append(pixel)
        raise FleetPoseError("three labels of the left image show nothing of the right")

    def _worth(self, place: Place, vain: list[Floats]) -> float:
        """How far a place is from what was picked, if its partner is known."""
        if self._partner(np.asarray(place)) is None:
            return -np.inf
        return min([float(np.linalg.norm(place - p)) for p in (*self.picked, *vain)], default=0.0)

    def _partner(self, pixel: Floats) -> Floats | None:
        """(2,) where the right image shows what is at a pixel of the left one; none where that is
        not known.
        """
        u, v = pixel.tolist()
        where = self.eyes.partner((u, v))
        return None if where is None else np.asarray(where)

    def _go(self, worth: Callable[[Place], float]) -> Floats:
        """Goes by the best label; returns where the cross then is."""
        self.press("g")
        self._wait("state.assist.hints.length > 0")
        best = max(self._knows("assist.hints"), key=lambda hint: worth(hint["pixel"]))
        self.press(*best["label"])
        self._wait("state.assist.hints.length === 0")
        return self._cursors()[best["side"]]

    # ---- looking ---------------------------------------------------------------------------------

    def _is_apart(self, pixel: Floats) -> bool:
        return all(np.linalg.norm(pixel - p) >= APART_PX for p in self.picked)

    def _cursors(self) -> tuple[Floats, Floats]:
        left, right = self._knows("cursors")
        return np.asarray(left), np.asarray(right)

    def _knows(self, path: str) -> Any:
        return hands.knows(self._page, path)

    def _wait(self, condition: str) -> None:
        hands.wait_knows(self._page, condition)


def _named(key: str) -> str:
    shift, _, arrow = key.rpartition("-")
    named = f"Arrow{arrow}" if arrow in ("Left", "Right", "Up", "Down") else arrow
    return f"Shift+{named}" if shift == "S" else named
