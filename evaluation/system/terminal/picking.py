"""How exactly an operator picks: targets by keys and by mouse, in a real terminal."""

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fleetpose.evaluation.system.terminal.fingers import arrow_keys
from fleetpose.evaluation.system.terminal.reading import ShownImage, images_on
from fleetpose.evaluation.system.terminal.tmux import Terminal
from fleetpose.hmi_client.tui.drawing.arrangement import arrange
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import wait_until

_MARGIN_PX = 12
SENT_S = 10.0
SETTLE_S = 0.3  # a person looks before the second click
SIZE = (640, 480)
_FREEZE_KEYS = 40  # arrows that are sent at once

Pixel = tuple[int, int]


@dataclass
class Picker:
    """Picks targets in both images of the pair on the screen, and reads what was sent.

    Args:
        terminal: with the client in it, a pair selected.
        notes: where the stand-in notes updates.
        by_mouse: click in the overview, then in the loupe; else arrows and Space.
    """

    terminal: Terminal
    notes: Path
    by_mouse: bool

    def worst_px(self, targets: int, seed: int) -> float:
        """The largest error of so many targets, half of them in each image, px."""
        rng = np.random.default_rng(seed)
        worst = 0.0
        for _ in range((targets + 1) // 2):
            wanted = [_target(rng), _target(rng)]
            before = len(self._noted())
            for side in (0, 1):
                self._pick(side, wanted[side])
            if not wait_until(lambda before=before: len(self._noted()) > before, SENT_S):
                shown = "\n".join(self.terminal.screen())
                raise FleetPoseError(f"{wanted} were picked, but nothing was sent:\n{shown}")
            record = self._noted()[before]
            got = (record["pixel_i"], record["pixel_j"])
            worst = max(worst, float(np.abs(np.subtract(got, wanted)).max()))
        return worst

    def _pick(self, side: int, target: Pixel) -> None:
        if self.by_mouse:
            self._click(side, target)
        else:
            self._press(side, target)

    def _press(self, side: int, target: Pixel) -> None:
        image = self._shown(side)
        if not image.focused:
            self.terminal.press("45"[side])
        keys = arrow_keys(*np.subtract(target, image.cursor))
        for start in range(0, len(keys), _FREEZE_KEYS):
            self.terminal.press(*keys[start : start + _FREEZE_KEYS])
        self._wait_cursor(side, target)
        self.terminal.press("Space")
        self._wait_focus(1 - side)

    def _click(self, side: int, target: Pixel) -> None:
        """A click in the overview brings the cursor near, one in the loupe picks."""
        image = self._shown(side)
        column, half_row = image.window(SIZE).half_cell(*target)
        self.terminal.click(image.left + column, image.top + half_row // 2)
        time.sleep(SETTLE_S)  # an expected point may have put the cursor near the target before
        near = self._wait_cursor(side, target, image.window(SIZE).px_per_half + 1)
        loupe = arrange(image.columns, image.rows - 1, SIZE[0] / SIZE[1]).loupe
        assert loupe is not None
        left, top, columns, rows = loupe
        u, v = np.subtract(target, near.cursor)
        x = left + columns // 2 + round(u)
        y = top + (rows + round(v)) // 2
        self.terminal.click(image.left + x, image.top + y)
        self._wait_focus(1 - side)

    def _shown(self, side: int) -> ShownImage:
        lines = self.terminal.wait(lambda lines: len(images_on(lines)) == 2, "both images")
        return images_on(lines)[side]

    def _wait_cursor(self, side: int, target: Pixel, within_px: float = 0.6) -> ShownImage:
        """The image once its cursor is there, twice the same: it may still be on its way."""
        before: ShownImage | None = None

        def there(lines: Sequence[str]) -> bool:
            nonlocal before
            images = images_on(lines)
            if len(images) != 2:
                return False
            now, last = images[side], before
            before = now
            near = bool(np.abs(np.subtract(now.cursor, target)).max() <= within_px)
            return near and last is not None and last.cursor == now.cursor

        return images_on(self.terminal.wait(there, f"the cursor at {target}"))[side]

    def _wait_focus(self, side: int) -> None:
        self.terminal.wait(
            lambda lines: len(images_on(lines)) == 2 and images_on(lines)[side].focused,
            f"the keys in image {side}",
        )

    def _noted(self) -> list[dict[str, list[float]]]:
        if not self.notes.exists():
            return []
        whole, _, _ = self.notes.read_text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()]


def _target(rng: np.random.Generator) -> Pixel:
    low, high = _MARGIN_PX, np.subtract(SIZE, _MARGIN_PX)
    u, v = rng.integers(low, high)
    return int(u), int(v)
