"""Bar 2: how exactly one picks, by mouse, pen and finger, on screens of several resolutions. The
truth is what the server received, beside the pixel that was meant.
"""

from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.system.terminal.stand_in import HEIGHT, WIDTH
from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.pointers import KINDS, Kind, Pointer
from fleetpose.evaluation.system.web.rows import Row, at_most, unmeasured
from fleetpose.evaluation.system.web.site import WebSite
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

RATIOS = (1.0, 1.25, 2.0)  # device pixels per CSS pixel
FIT_PX, FINE_PX = 0.71, 0.1  # of the screen: half the diagonal of a pixel; of the image
ZOOM = 8.0
_MARGIN_PX = 40
_RECEIVED_S = 5.0
_ABOUT_PX = 3.0
_TAP_PX, _AWAY_PX, _DRAGS = 4.0, 40.0, 6  # less than a drag; and how a finger corrects so little
_AT_ONCE_MS = 80  # that a hand rests between two deeds

Pixel = tuple[float, float]


class Picker:
    """Picks pixels of the images of a pair: one half at fit, the other at the loupe.

    Args:
        page: a pair selected.
        site: where the picks arrive.
        kind: the pointer.
        dpr: of the page.
    """

    def __init__(self, page: Any, site: WebSite, kind: Kind, dpr: float) -> None:
        self._page, self._site = page, site
        self._pointer = Pointer(page, kind, dpr)
        self.fit_px: list[float] = []
        self.fine_px: list[float] = []

    def point(self, at_fit: Pixel, at_loupe: Pixel) -> None:
        """A point: its half in the left image at fit, in the right one at the loupe.

        Raises:
            FleetPoseError: the server received nothing.
        """
        before = len(self._site.received())
        self._go(0, at_fit)
        self._press_pick()
        hands.wait_knows(self._page, "state.list.half && state.active === 1")
        self._go(1, at_loupe)
        self._pick_in_loupe(1, at_loupe)
        if not wait_until(lambda: len(self._site.received()) > before, _RECEIVED_S):
            raise FleetPoseError(f"{at_fit} and {at_loupe} were picked, but nothing came")
        got = self._site.received()[before]
        off = np.subtract(got["pixel_i"], at_fit) * self._scale(0)
        self.fit_px.append(float(np.hypot(*off)))
        self.fine_px.append(float(np.hypot(*np.subtract(got["pixel_j"], at_loupe))))
        hands.wait_knows(self._page, "!state.list.half")

    def _go(self, side: int, pixel: Pixel) -> None:
        """A click into the image brings its cross."""
        left, top, width, height = self._box(side, "photo")
        u, v = np.subtract(pixel, ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)) * self._scale(side)
        self._pointer.click(left + width / 2 + u, top + height / 2 + v)
        self._see_cross(side, pixel)

    def _pick_in_loupe(self, side: int, pixel: Pixel) -> None:
        """A click picks; a finger moves the picture under the cross, and the button picks."""
        left, top, width, height = self._box(side, "loupe")
        x, y = left + width / 2, top + height / 2
        if self._pointer.kind != "touch":
            off = self._off(side, pixel)
            self._pointer.click(x + off[0], y + off[1])
            return
        x, y = self._pointer.whole(x), self._pointer.whole(y)  # so that it rounds the end alone
        for _ in range(_DRAGS):
            off = self._off(side, pixel)
            if np.hypot(*off) < 0.75:
                break
            short = np.hypot(*off) < _TAP_PX  # first away from it, then back
            self._pointer.drag(x, y, *(np.array((_AWAY_PX, 0.0)) if short else -off))
            self._page.wait_for_timeout(_AT_ONCE_MS)
        self._see_cross(side, pixel)
        self._press_pick()

    def _off(self, side: int, pixel: Pixel) -> Floats:
        """(2,) from the cross to a pixel, CSS pixels of the loupe."""
        return np.subtract(pixel, hands.knows(self._page, f"cursors.{side}")) * ZOOM

    def _see_cross(self, side: int, pixel: Pixel) -> None:
        """Waits until the cross is about there, as a person does."""
        u, v = pixel
        off = f"Math.hypot(at[0] - {u}, at[1] - {v}) < {_ABOUT_PX}"
        hands.wait_knows(self._page, f"((at) => at && {off})(state.cursors[{side}])")

    def _scale(self, side: int) -> float:
        """CSS pixels per pixel of the image, all of which is to be seen."""
        _, _, width, height = self._box(side, "photo")
        return min(width / WIDTH, height / HEIGHT)

    def _press_pick(self) -> None:
        if self._pointer.kind == "touch":
            left, top, width, height = self._box_of("[data-deed=pick]:visible")
            self._pointer.click(left + width / 2, top + height / 2)
        else:
            self._page.keyboard.press("Space")

    def _box(self, side: int, canvas: str) -> tuple[float, float, float, float]:
        return self._box_of(f"{hands.SIDES[side]} canvas.{canvas}")

    def _box_of(self, what: str) -> tuple[float, float, float, float]:
        """Left, top, width and height; a button may be drawn anew while it is looked for."""
        found: list[Any] = []

        def is_there() -> bool:
            found[:] = [self._page.locator(what).first.bounding_box()]
            return found[0] is not None

        if not wait_until(is_there, _RECEIVED_S):
            raise FleetPoseError(f"there is no {what} in the page")
        (box,) = found
        return box["x"], box["y"], box["width"], box["height"]


def exactly_picked(bench: Bench) -> list[Row]:
    """Points by each pointer at each resolution; the largest errors."""
    rows = []
    for ratio in RATIOS:
        for kind in KINDS:
            bench.said(f"{kind}, {ratio:g} device pixels")
            what = f"{kind}, device pixel ratio {ratio:g}"
            try:
                picker = _picked(bench, kind, ratio)
            except FleetPoseError as error:
                rows.append(unmeasured(2, what, str(error)))
                continue
            rows.append(
                at_most(
                    2, f"largest error at fit, {what}, px of the screen", max(picker.fit_px), FIT_PX
                )
            )
            rows.append(
                at_most(
                    2,
                    f"largest error at zoom 8, {what}, px of the image",
                    max(picker.fine_px),
                    FINE_PX,
                )
            )
    return rows


def _picked(bench: Bench, kind: Kind, ratio: float) -> Picker:
    page = bench.browser.page(bench.site.address(), dpr=ratio, touch=kind == "touch")
    hands.open_pair(page)
    picker = Picker(page, bench.site, kind, ratio)
    rng = np.random.default_rng(0)
    low, high = (_MARGIN_PX, _MARGIN_PX), (WIDTH - _MARGIN_PX, HEIGHT - _MARGIN_PX)
    for _ in range(bench.many(12, 3)):
        one, other = rng.integers(low, high, (2, 2))
        picker.point((float(one[0]), float(one[1])), (float(other[0]), float(other[1])))
    bench.screenshot(page, f"{kind}_{ratio:g}")
    page.context.close()
    return picker
