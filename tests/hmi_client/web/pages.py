"""What tests of the page share: sizes, places, and waiting for what a page shows."""

import os
import time
from pathlib import Path

import scenes

DESK, TABLET = (1600, 1000), (1024, 768)
LEFT, RIGHT = "[data-panel=left]", "[data-panel=right]"
SETTLED = """document.fonts.ready.then(() => new Promise((done) =>
    requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))))"""
CENTRE = ((scenes.WIDTH - 1) / 2, (scenes.HEIGHT - 1) / 2)
FREE = [f for f in scenes.half() if not isinstance(f, dict) or f["t"] not in ("list", "assist")]
FREE.insert(0, scenes.listing((2, 7), []))
"""A pair with images and nothing clicked."""


def until(page, done, timeout_s: float = 10.0) -> None:
    end = time.monotonic() + timeout_s
    while not done():
        said = page.inner_text("#bar") if time.monotonic() > end else None
        assert said is None, f"not within {timeout_s} s; the bar says {said!r}"
        page.wait_for_timeout(10)


def shot(page, name: str) -> None:
    if folder := os.environ.get("FLEETPOSE_SHOTS"):
        page.wait_for_timeout(150)
        page.screenshot(path=Path(folder) / f"{name}.png")


def place(page, side: str, canvas: str, pixel: tuple[float, float], middle: tuple[float, float]):
    """Where an image pixel is on the screen; for a loupe `middle` is the pixel under its cross."""
    box = page.locator(f"{side} canvas.{canvas}").bounding_box()
    centre = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    if canvas == "loupe":
        scale = 8.0
    else:
        scale = min(box["width"] / scenes.WIDTH, box["height"] / scenes.HEIGHT)
    return tuple(c + (p - m) * scale for c, p, m in zip(centre, pixel, middle, strict=True))
