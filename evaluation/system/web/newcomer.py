"""People who try the operator's page: what they see, what their hands do, and how often."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats, inverse
from fleetpose.evaluation.system.observer import SeenView
from fleetpose.evaluation.system.truth import Truth
from fleetpose.evaluation.system.web.hands import SIDES
from fleetpose.protocol.clouds import points_of
from fleetpose.protocol.errors import FleetPoseError

POINTS = 3  # that say where a robot is
SHOWN_S = 15.0  # that is waited for what a deed should show
MOST = 40  # deeds until a newcomer gives up
COMMON = 100  # points that two images share, for a person to see that they show the same
APART_PX = 25.0  # points that are nearer to each other tell little more
GOOD_PX = 4.0  # nearer than that two crosses show the same point to an eye at the loupe
KNOWN_PX = 6.0  # from a pixel to one whose depth is known
LOUPE = 8.0  # CSS pixels per pixel
PRIMARY = "#bar .primary"
_SUGGESTED = "both crosses"
Pixel = tuple[float, float]


@dataclass(frozen=True)
class Eyes:
    """What a person sees who compares two images, from what is true of them.

    Attributes:
        clouds: xyz (N, 3), metres, and uv (N, 2), px, of each view.
        K: (3, 3) px of each camera.
        T_i_j: (4, 4) true, of the cameras.
        uv_i, uv_j: (M, 2) pixels that show the same points.
        sizes: width and height of each image.
    """

    clouds: tuple[tuple[Floats, Floats], tuple[Floats, Floats]]
    K: tuple[Floats, Floats]
    T_i_j: Floats
    uv_i: Floats
    uv_j: Floats
    sizes: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, truth: Truth, i: SeenView, j: SeenView) -> "Eyes":
        """Of two views of a fleet.

        Raises:
            FleetPoseError: it is not known where they were seen from.
        """
        worlds = [truth.T_world_robot(one) for one in (i, j)]
        if worlds[0] is None or worlds[1] is None:
            raise FleetPoseError(f"it is not known where {i.view.name} was seen from")
        cameras = [one.view.camera for one in (i, j)]
        T_world = [T @ c.T_robot_camera for T, c in zip(worlds, cameras, strict=True)]
        found = [points_of(one.view) for one in (i, j)]
        return cls(
            ((found[0].xyz, found[0].uv), (found[1].xyz, found[1].uv)),
            (cameras[0].K, cameras[1].K),
            inverse(T_world[0]) @ T_world[1],
            *truth.correspondences(i, j),
            ((cameras[0].width, cameras[0].height), (cameras[1].width, cameras[1].height)),
        )

    def same(self, left: Pixel, right: Pixel) -> bool:
        """Whether two pixels show the same point: by the depth of either, at the true pose."""
        there = self._seen_at(0, left, inverse(self.T_i_j))
        back = self._seen_at(1, right, self.T_i_j)
        return any(
            seen is not None and math.dist(seen, other) < GOOD_PX
            for seen, other in ((there, right), (back, left))
        )

    def partner(self, pixel: Pixel) -> Pixel | None:
        """Where the right image shows what a pixel of the left one shows; none where nothing near
        it is seen by both.
        """
        if not len(self.uv_i) or np.linalg.norm(self.uv_i - pixel, axis=1).min() > KNOWN_PX:
            return None
        return self._seen_at(0, pixel, inverse(self.T_i_j))

    def _seen_at(self, side: int, pixel: Pixel, T_other_here: Floats) -> Pixel | None:
        """Where the other image shows what a pixel shows."""
        xyz, uv = self.clouds[side]
        far = np.linalg.norm(uv - pixel, axis=1)
        nearest = int(np.argmin(far))
        if far[nearest] > KNOWN_PX:
            return None
        point = np.linalg.inv(self.K[side]) @ (*pixel, 1.0) * xyz[nearest, 2]
        moved = self.K[1 - side] @ (T_other_here[:3, :3] @ point + T_other_here[:3, 3])
        return float(moved[0] / moved[2]), float(moved[1] / moved[2])


@dataclass(frozen=True)
class Hand:
    """How somebody does what the bar proposes, says yes and no to a suggestion, and goes on to the
    next question.
    """

    go: Callable[[], None]
    yes: Callable[[], None]
    no: Callable[[], None]
    next: Callable[[], None]


@dataclass
class Newcomer:
    """Hands at a page, and a count of what they did.

    Args:
        page: of playwright, open.
        eyes: which pixel of the right image shows what one of the left image shows.
        shots: where pictures of the page are kept.
    """

    page: Any
    eyes: Callable[[str, str], Eyes]
    shots: Path
    deeds: int = 0
    picked: list[Pixel] = field(default_factory=list)

    # ---- hands -----------------------------------------------------------------------------------

    def click(self, what: str) -> None:
        """Clicks an element."""
        self.deeds += 1
        self.page.click(what, timeout=1000 * SHOWN_S)

    def click_at(self, side: int, canvas: str, pixel: Pixel) -> None:
        """Clicks a pixel of a side's image or loupe."""
        self.deeds += 1
        box = self.page.locator(f"{SIDES[side]} canvas.{canvas}").bounding_box()
        width, height = self.sizes[side]
        middle, scale = self.cross(side), LOUPE
        if canvas == "photo":
            middle = ((width - 1) / 2, (height - 1) / 2)
            scale = min(box["width"] / width, box["height"] / height)
        x, y = (p - m for p, m in zip(pixel, middle, strict=True))
        self.page.mouse.click(
            box["x"] + box["width"] / 2 + x * scale, box["y"] + box["height"] / 2 + y * scale
        )

    def press(self, *keys: str) -> None:
        """Presses keys, one after the other."""
        for key in keys:
            self.deeds += 1
            self.page.keyboard.press(key)

    # ---- eyes ------------------------------------------------------------------------------------

    def bar(self) -> str:
        """The sentence of the bar."""
        return str(self.page.inner_text("#bar h1"))

    def cross(self, side: int) -> Pixel:
        """Where the page says that a cross is."""
        place = self.page.inner_text(f"{SIDES[side]} .place")
        u, v = place.partition(" px")[0].split(", ")
        return float(u), float(v)

    def pair(self) -> tuple[str, str]:
        """The robots whose images are shown."""
        left, right = (self.page.inner_text(f"{side} .robot") for side in SIDES)
        return left, right

    def until(self, what: str, done: Callable[[], Any], seconds: float = SHOWN_S) -> None:
        """Looks until something is so.

        Raises:
            FleetPoseError: it does not become so in time.
        """
        end = time.monotonic() + seconds
        while not done():
            if time.monotonic() > end:
                self.shot("stuck")
                raise FleetPoseError(f"no {what} in {seconds:g} s; the bar says {self.bar()!r}")
            self.page.wait_for_timeout(20)

    def shot(self, name: str) -> None:
        """Keeps a picture of the page."""
        self.page.screenshot(path=self.shots / f"{name}.png")

    def look(self) -> Eyes:
        """Waits for both images, and knows what they show."""
        place = lambda side: self.page.inner_text(f"{SIDES[side]} .place")  # noqa: E731
        self.until("two images", lambda: place(0) and place(1))
        eyes = self.eyes(*self.pair())
        self.sizes = eyes.sizes
        return eyes

    def joined(self) -> bool:
        """Whether the page says that all robots are located."""
        counts = self.page.inner_text("#summary .good").split()  # "● 5 of 6 located"
        return counts[1] == counts[3] and self.page.locator("#summary .apart").count() == 0

    # ---- answers ---------------------------------------------------------------------------------

    def answer(self, hand: Hand) -> None:
        """Does what the bar proposes until the fleet is joined: says yes or no where that is asked,
        and goes on where the two images show different things.

        Raises:
            FleetPoseError: that leads nowhere.
        """
        while not self.joined():
            if self.deeds >= MOST:
                raise FleetPoseError(f"not joined after {MOST} deeds; the bar says {self.bar()!r}")
            self.until("proposal", lambda: self.joined() or self._is_offered())
            asked = self._asked()
            self._step(hand)
            self.until("change", lambda asked=asked: self._asked() != asked or self.joined())
            self.page.wait_for_timeout(1500 if len(self.picked) >= POINTS else 300)  # it is read
        self.page.wait_for_timeout(1000)
        self.shot("joined")

    def _step(self, hand: Hand) -> None:
        self.shot(f"step-{self.deeds}")
        shown = bool(self.page.inner_text(f"{SIDES[0]} .place"))
        if not shown:
            hand.go()
        elif _SUGGESTED not in self.bar():
            (hand.go if len(self.look().uv_i) >= COMMON else hand.next)()
        elif self._same():
            self.picked.append(self.cross(0))
            hand.yes()
        else:
            hand.no()

    def _same(self) -> bool:
        """Whether both crosses show the same point, away from those that were picked."""
        left, right = self.cross(0), self.cross(1)
        apart = all(math.dist(left, p) >= APART_PX for p in self.picked)
        return apart and self.look().same(left, right)

    def _is_offered(self) -> bool:
        pairs, places = zip(*(self._shown(side) for side in SIDES), strict=True)
        return self.page.locator(PRIMARY).count() > 0 and ("–" in pairs or all(places))

    def _shown(self, side: str) -> tuple[str, str]:
        return self.page.inner_text(f"{side} .robot"), self.page.inner_text(f"{side} .place")

    def _asked(self) -> str:
        return f"{self.bar()} {[self._shown(side) for side in SIDES]}"

    def pick_by_mouse(self, left: Pixel, right: Pixel) -> None:
        """A click near, one in the loupe; the same in the other image, where that is needed."""
        before = self._whole()
        for side, pixel in enumerate((left, right)):
            if math.dist(self.cross(side), pixel) > 12:
                self.click_at(side, "photo", pixel)
                self.until("cross", lambda s=side, p=pixel: math.dist(self.cross(s), p) < 3)
            self.click_at(side, "loupe", pixel)
            if side == 0:
                self.until("half", lambda: "now pick the same" in self.bar())
                self.page.wait_for_timeout(600)  # the place where it is expected comes
        self.until("new point", lambda: self._whole() > before)
        self.page.wait_for_timeout(2000)  # what came of it is read

    def _whole(self) -> int:
        """How many points of the list are in both images."""
        return int(self.page.locator("#pair .say:not(.half)").count())

    def mend(self) -> int:
        """Does what the bar proposes while it says that a point does not fit; how many deeds."""
        before = self.deeds
        while "does not fit" in self.bar():
            said = self.page.inner_text("#bar")
            self.click(PRIMARY)
            self.until("change", lambda said=said: self.page.inner_text("#bar") != said)
            self.page.wait_for_timeout(600)
        return self.deeds - before
