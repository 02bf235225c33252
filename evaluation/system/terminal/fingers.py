"""A simulated operator at the keyboard: sees what is on the screen, knows what two pixels show, and
presses keys.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fleetpose.evaluation.metrics.geometry import Floats
from fleetpose.evaluation.system.observer import Observer, SeenView
from fleetpose.evaluation.system.terminal.interruption import Interruption
from fleetpose.evaluation.system.terminal.reading import ShownImage, images_on
from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.evaluation.system.truth import Truth
from fleetpose.protocol.errors import FleetPoseError

Place = Sequence[float] | Floats

GOOD_PX = 3.0  # nearer than that two crosses show the same point to an eye at the loupe
CORRECTED_KEYS = 8  # a suggestion that is off is corrected if that many keys do it
APART_PX = 60.0  # points that are nearer to each other tell little more
MOST_LABELS = 5  # that are tried for one point
_KNOWN_PX = 6.0  # how far a pixel may be from one whose partner is known
_SUGGESTION = "do both crosses show the same point?"


@dataclass
class Eyes:
    """Which pixel of the right image shows what a pixel of the left one shows."""

    uv_i: Floats
    uv_j: Floats
    sizes: tuple[tuple[int, int], tuple[int, int]]

    @classmethod
    def of(cls, truth: Truth, i: SeenView, j: SeenView) -> "Eyes":
        """Of two views of a fleet."""
        uv_i, uv_j = truth.correspondences(i, j)
        sizes = tuple((s.view.camera.width, s.view.camera.height) for s in (i, j))
        return cls(uv_i, uv_j, (sizes[0], sizes[1]))

    def partner(self, pixel: Place) -> Floats | None:
        """(2,) the pixel of the right image; none where the left one is not seen there."""
        if not len(self.uv_i):
            return None
        far = np.linalg.norm(self.uv_i - pixel, axis=1)
        at = int(np.argmin(far))
        if far[at] > _KNOWN_PX:
            return None
        return self.uv_j[at] + np.asarray(pixel) - self.uv_i[at]


def arrow_keys(du: float, dv: float) -> list[str]:
    """The fewest arrows, with Shift and without, that move a cursor by whole pixels."""
    keys = []
    for step, (less, more) in ((du, ("Left", "Right")), (dv, ("Up", "Down"))):
        whole = round(step)
        tens = round(whole / 10)
        ones = whole - 10 * tens
        keys += [f"S-{more if tens > 0 else less}"] * abs(tens)
        keys += [more if ones > 0 else less] * abs(ones)
    return keys


@dataclass
class Fingers:
    """Answers one question after the other.

    Args:
        terminal: with the client in it.
        observer, truth: what the eyes behind the fingers know.
        screens: where screens are kept.
        interruption: what happens in the middle of a click.
    """

    terminal: Terminal
    observer: Observer
    truth: Truth
    screens: Path
    interruption: Interruption | None = None
    picked: list[Floats] = field(default_factory=list)
    suggested: int = 0

    def answer(self, points: int, by_hand: bool = False) -> tuple[str, str]:
        """WeightedRoundRobin to the first question and clicks so many points; returns its robots.

        Args:
            points: how many.
            by_hand: do without suggestions.
        """
        self.terminal.press("n")
        self.terminal.wait(lambda lines: len(images_on(lines)) == 2, "two images", 15.0)
        left, right = self._images()
        eyes = self._eyes(left, right)
        self.terminal.keep(self.screens, "question")
        if not by_hand:
            self._by_suggestions(eyes, points)
        while len(self.picked) < points:
            self._by_hand(eyes)
        return left.robot, right.robot

    # ---- suggestions -----------------------------------------------------------------------------

    def _by_suggestions(self, eyes: Eyes, points: int) -> None:
        self.terminal.press("Tab")
        offered = self.terminal.wait(
            lambda lines: _says(lines, _SUGGESTION) or _says(lines, "is suggested"),
            "a suggestion",
        )
        while _says(offered, _SUGGESTION) and len(self.picked) < points:
            number = _number(offered)
            left, right = self._images()
            where = eyes.partner(left.cursor)
            keys = None if where is None else self._towards(left, right, where)
            if where is not None and keys is not None and self._is_apart(left.cursor):
                self._press_in(right, keys)
                self.terminal.keep(self.screens, f"suggestion-{number}-taken")
                self.picked.append(np.asarray(left.cursor))
                self.suggested += 1
                self.terminal.press("Tab")
            else:
                self.terminal.keep(self.screens, f"suggestion-{number}-skipped")
                self.terminal.press("BTab")
            offered = self.terminal.wait(
                lambda lines, number=number: _number(lines) != number, "the next suggestion"
            )
        if _says(offered, _SUGGESTION):
            self.terminal.press("c")
            self.terminal.wait(lambda lines: not _says(lines, _SUGGESTION), "no suggestion")

    def _towards(self, left: ShownImage, right: ShownImage, where: Floats) -> list[str] | None:
        """The keys that correct the right cross, none if that costs too many."""
        off = where - right.cursor
        if np.linalg.norm(off) < GOOD_PX:
            return []
        keys = arrow_keys(*off)
        return keys if len(keys) + (not right.focused) <= CORRECTED_KEYS else None

    # ---- by hand ---------------------------------------------------------------------------------

    def _by_hand(self, eyes: Eyes) -> None:
        """One point: a label in the left image, then what is expected in the right one, corrected
        from there or from the nearest label.
        """
        before = len(self.picked)
        self.terminal.press("4")
        self._wait_images(lambda left, right: left.focused)
        where = self._go_where_both_see(eyes)
        self.terminal.press("Space")
        right = self._wait_images(lambda left, right: right.focused)[1]
        self.terminal.keep(self.screens, f"point-{before + 1}-half")
        if self.interruption is not None:
            self.interruption.half(before + 1)
        if len(arrow_keys(*(where - right.cursor))) > CORRECTED_KEYS:
            self._go(1, lambda place: -float(np.linalg.norm(where - place)), eyes)
            right = self._images()[1]
        self._press_in(right, arrow_keys(*(where - right.cursor)))
        self.terminal.keep(self.screens, f"point-{before + 1}-whole")
        self.terminal.press("Space")
        self._wait_images(lambda left, right: left.focused)
        if self.interruption is not None:
            self.interruption.whole(before + 1)

    def _go_where_both_see(self, eyes: Eyes) -> Floats:
        """Goes to a place of the left image and returns where the right one shows it, (2,)."""
        vain: list[Floats] = []
        while len(vain) < MOST_LABELS:
            pixel = self._go(0, lambda place: self._worth(eyes, place, vain), eyes)
            where = eyes.partner(pixel)
            if where is not None:
                self.picked.append(pixel)
                return where
            vain.append(pixel)
        raise FleetPoseError(f"{MOST_LABELS} labels of the left image show nothing of the right")

    def _worth(self, eyes: Eyes, place: Place, vain: Sequence[Floats]) -> float:
        """How far a place of the left image is from what was picked, if its partner is known."""
        far = np.linalg.norm(eyes.uv_i - place, axis=1)
        if not len(far):
            return -float("inf")
        apart = [float(np.linalg.norm(np.asarray(place) - p)) for p in (*self.picked, *vain)]
        return min([*apart, 1e3]) - 10.0 * float(far.min())

    def _go(self, side: int, worth: Callable[[Place], float], eyes: Eyes) -> Floats:
        """Goes by the best label; returns where the cursor then is."""
        self.terminal.press("g")
        size = eyes.sizes[side]
        lines = self.terminal.wait(
            lambda lines: bool(images_on(lines)[side].labels(size)), "labels in the image"
        )
        labels = images_on(lines)[side].labels(size)
        best = max(labels, key=lambda label: worth(labels[label]))
        self.terminal.press(*best)
        # a label may stand where the cursor is, which then does not move
        self.terminal.wait(
            lambda lines: (
                _beside(images_on(lines)[side], labels[best], size)
                and not images_on(lines)[side].labels(size)
            ),
            f"the cursor at {best}",
        )
        return np.asarray(self._images()[side].cursor)

    # ---- looking ---------------------------------------------------------------------------------

    def _press_in(self, image: ShownImage, keys: Sequence[str]) -> None:
        """Presses keys in an image; waits until its cursor is where they lead."""
        if not keys:
            return
        if not image.focused:
            self.terminal.press("5")
        steps = {"Left": (-1, 0), "Right": (1, 0), "Up": (0, -1), "Down": (0, 1)}
        goal = np.asarray(image.cursor)
        for key in keys:
            goal = goal + np.multiply(steps[key[-5:].lstrip("S-")], 10 if "S-" in key else 1)
        self.terminal.press(*keys)
        self.terminal.wait(
            lambda lines: any(
                shown.robot == image.robot and np.abs(goal - shown.cursor).max() <= 1
                for shown in images_on(lines)
            ),
            f"the cursor at {goal}",
        )

    def _is_apart(self, pixel: Place) -> bool:
        return all(np.linalg.norm(np.subtract(pixel, p)) >= APART_PX for p in self.picked)

    def _images(self) -> tuple[ShownImage, ShownImage]:
        return self._wait_images(lambda left, right: True)

    def _wait_images(
        self, condition: Callable[[ShownImage, ShownImage], bool]
    ) -> tuple[ShownImage, ShownImage]:
        """Both images once a condition holds, and they look the same twice: the screen may have
        been read while it was drawn.
        """
        before: list[ShownImage] = []

        def holds(lines: list[str]) -> bool:
            nonlocal before
            shown, last = images_on(lines), before
            before = shown
            return len(shown) == 2 and condition(shown[0], shown[1]) and shown == last

        shown = images_on(self.terminal.wait(holds, "both images"))
        return shown[0], shown[1]

    def _eyes(self, left: ShownImage, right: ShownImage) -> Eyes:
        seen = [self.observer.newest_view(shown.robot) for shown in (left, right)]
        if seen[0] is None or seen[1] is None:
            raise FleetPoseError(f"no view of {left.robot} or {right.robot} was heard")
        return Eyes.of(self.truth, seen[0], seen[1])


def _says(lines: Sequence[str], text: str) -> bool:
    return any(text in line for line in lines)


def _number(lines: Sequence[str]) -> str:
    """Which suggestion is on the screen."""
    for line in lines:
        if _SUGGESTION in line:
            return line.split("Suggestion")[1].split(":")[0].strip().replace(" ", "-")
    return ""


def _beside(image: ShownImage, place: Place, size: tuple[int, int]) -> bool:
    """Whether a cursor is where a label stood, which is known to about a cell."""
    window = image.window(size)
    cell = np.subtract(window.pixel(1, 2), window.pixel(0, 0))
    return bool(np.all(np.abs(np.subtract(image.cursor, place)) <= 1.5 * np.abs(cell)))
