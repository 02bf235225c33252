"""What an operator does with a page: selects a pair, clicks, presses keys. And what the page knows,
read from its own modules, so that nothing in the product is there for a test alone.
"""

import json
from typing import Any

from fleetpose.evaluation.system.web.browser import became
from fleetpose.protocol.errors import FleetPoseError

LEFT, RIGHT = "[data-panel=left]", "[data-panel=right]"
SIDES = (LEFT, RIGHT)
WITHIN_S = 15.0
STORE = "/static/link/store.js"
RUN = "async ([id, args]) => (await import('/static/link/commands.js')).run(id, args)"
"""Does a command of the page, by its id and with arguments, as a button does."""
_STATE = """async (path) => {
    const { state } = await import('/static/link/store.js');
    return path.split('.').reduce((at, key) => at?.[key], state) ?? null;
}"""


def knows(page: Any, path: str) -> Any:
    """What the page's state holds, as `list.points` or `health`; None where it holds nothing."""
    return page.evaluate(_STATE, path)


def wait_knows(page: Any, condition: str, timeout_s: float = WITHIN_S) -> None:
    """Waits until an expression of JavaScript on `state` is true in a page.

    Raises:
        FleetPoseError: it does not become true.
    """
    asked = f"async () => {{ const {{ state }} = await import('{STORE}'); return {condition}; }}"
    if not became(page, asked, timeout_s=timeout_s):
        raise FleetPoseError(f"after {timeout_s:g} s it is not so in the page: {condition}")


def open_pair(page: Any) -> tuple[str, str]:
    """Takes the next question and waits for both images; returns the robots' names. An operator
    who is there by another page may have a pair already.
    """
    wait_knows(page, "state.questions.length > 0")
    before = json.dumps(",".join(knows(page, "list.pair") or ()))
    page.keyboard.press("n")
    taken = f"state.list.pair && String(state.list.pair) !== {before}"
    wait_knows(page, f"{taken} && state.images[0] && state.images[1]")
    first, second = knows(page, "list.pair")
    return first, second


def click_loupe(page: Any, side: int, x: float = 0.5, y: float = 0.5) -> None:
    """Picks by a click in a side's loupe; the place as shares of its size."""
    box = page.locator(f"{SIDES[side]} canvas.loupe").bounding_box()
    page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])


def click_image(page: Any, side: int, x: float = 0.5, y: float = 0.5) -> None:
    """Brings the cross of a side by a click in its image; the place as shares of its size."""
    box = page.locator(f"{SIDES[side]} canvas.photo").bounding_box()
    page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])


def count_images(page: Any) -> None:
    """Counts the images of both sides from now on, in the page."""
    page.evaluate(_COUNT)


def images_seen(page: Any) -> int:
    """How many were drawn since `count_images`."""
    return page.evaluate("() => window.imagesSeen")


_COUNT = f"""async () => {{
    const {{ state }} = await import('{STORE}');
    const last = [null, null];
    window.imagesSeen = 0;
    const look = () => {{
        for (const side of [0, 1]) {{
            const view = state.images[side]?.view ?? null;
            if (view !== null && view !== last[side]) window.imagesSeen += 1;
            last[side] = view;
        }}
        requestAnimationFrame(look);
    }};
    look();
}}"""


def pick_by_keys(page: Any, points: int) -> None:
    """Points where the crosses are, whether or not a server hears of them."""
    for _ in range(points):
        page.keyboard.press("4")
        page.keyboard.press("Space")
        wait_knows(page, "state.list.half && state.active === 1")
        page.keyboard.press("Space")
        wait_knows(page, "!state.list.half")
