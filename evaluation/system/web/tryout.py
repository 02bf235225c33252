"""A newcomer tries the operator's page on a fleet of simulated robots: by mouse alone, by keys
alone, and with a wrong click. The newcomer knows nothing but what the page shows, and what pixels show.
"""

import math
import os
import secrets
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet, wait_running
from fleetpose.evaluation.report.output import output_folder
from fleetpose.evaluation.simulate.operator import far_apart
from fleetpose.evaluation.system.demo import demo_plan, start_demo
from fleetpose.evaluation.system.fleet import FleetPlan, observed, wait_started
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.terminal.fingers import APART_PX, GOOD_PX, Eyes
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import free_port

ROBOTS = 6
POINTS = 3  # that say where a robot is
STARTED_S = 60.0
SHOWN_S = 15.0  # that the newcomer waits for what a deed should show
JOINED_S = 20.0
SIDES = ("[data-panel=left]", "[data-panel=right]")
COMMON = 100  # points that two images share, for a person to see that they show the same
_SUGGESTED = "both crosses"
LOUPE = 8.0  # CSS pixels per pixel
PRIMARY = "#bar .primary"
Pixel = tuple[float, float]


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
        return self.page.locator("#summary .apart").count() == 0

    # ---- answers ---------------------------------------------------------------------------------

    def answer(self, hand: "Hand") -> None:
        """Takes the best question that both images can answer, and its suggestions, until the fleet
        is joined.
        """
        hand.go()
        eyes = self.look()
        while len(eyes.uv_i) < COMMON:  # at a glance, they show different things
            before = self.pair()
            hand.next()
            self.until("other pair", lambda before=before: self.pair() != before)
            eyes = self.look()
        self.until("offer", lambda: "see the same point" in self.bar())
        self.shot("question")
        hand.go()
        self.until("suggestion", lambda: _SUGGESTED in self.bar())
        self.shot("suggestion")
        while not self.joined() and _SUGGESTED in self.bar():
            asked = self._asked()
            left, right = self.cross(0), self.cross(1)
            partner = eyes.partner(left)
            good = partner is not None and math.dist(partner, right) < GOOD_PX
            if good and all(math.dist(left, p) >= APART_PX for p in self.picked):
                self.picked.append(left)
                hand.yes()
            else:
                hand.no()
            self.until("next step", lambda asked=asked: self._asked() != asked or self.joined())
            if len(self.picked) >= POINTS:
                self.page.wait_for_timeout(1500)  # a person sees what came of it
        self.until("joined fleet", self.joined, JOINED_S)
        self.page.wait_for_timeout(1000)
        self.shot("joined")

    def _asked(self) -> str:
        return f"{self.bar()} {self.cross(0)}"

    def pick_by_mouse(self, left: Pixel, right: Pixel) -> None:
        """A click near, one in the loupe; the same in the other image, where that is needed."""
        before = self.page.locator("#pair .row").count()
        for side, pixel in enumerate((left, right)):
            if math.dist(self.cross(side), pixel) > 12:
                self.click_at(side, "photo", pixel)
                self.until("cross", lambda s=side, p=pixel: math.dist(self.cross(s), p) < 3)
            self.click_at(side, "loupe", pixel)
            if side == 0:
                self.until("half", lambda: "now pick the same" in self.bar())
                self.page.wait_for_timeout(600)  # the place where it is expected comes
        self.until("new point", lambda: self.page.locator("#pair .row").count() > before)
        self.page.wait_for_timeout(600)  # what came of it is read

    def mend(self) -> int:
        """Does what the bar proposes while it says that a point does not fit; how many deeds."""
        before = self.deeds
        while "does not fit" in self.bar():
            said = self.page.inner_text("#bar")
            self.click(PRIMARY)
            self.until("change", lambda said=said: self.page.inner_text("#bar") != said)
            self.page.wait_for_timeout(600)
        return self.deeds - before


@dataclass
class _Trial:
    """A fleet whose last robot waits for clicks, its page, and a browser."""

    fleet: LocalFleet
    plan: FleetPlan
    observer: Observer
    url: str
    tokens: dict[str, str]
    chromium: Any
    out: Path

    @contextmanager
    def newcomer(self, name: str) -> Iterator[Newcomer]:
        """Somebody at a page of his own; what he clicked is taken back at the end."""
        page = self.chromium.new_page(viewport={"width": 1600, "height": 1000})
        page.goto(f"{self.url}#token={self.tokens[name]}")
        shots = self.out / name
        shots.mkdir(parents=True, exist_ok=True)
        who = Newcomer(page, self._eyes, shots)
        who.until("question", lambda: "best question" in who.bar(), STARTED_S)
        yield who
        self._take_back(page)
        page.close()

    def by_mouse(self) -> int:
        """Clicks from the first sight of the page to the joined fleet."""
        with self.newcomer("mouse") as who:
            go = lambda: who.click(PRIMARY)  # noqa: E731
            no = lambda: who.click("#bar .button:nth-of-type(2)")  # noqa: E731
            who.answer(Hand(go, go, no, lambda: who.click("footer .hint:first-child")))
        return who.deeds

    def by_keys(self) -> int:
        """Keys for the same."""
        with self.newcomer("keys") as who:
            keys = (lambda k=k: who.press(k) for k in ("Enter", "Tab", "Shift+Tab", "n"))
            who.answer(Hand(*keys))
        return who.deeds

    def with_a_wrong_click(self) -> dict[str, Any]:
        """The second point is clicked at another one, as if both were targets that look alike."""
        with self.newcomer("wrong") as who:
            who.click(PRIMARY)
            eyes = who.look()
            order = far_apart(eyes.uv_i, 8, np.random.default_rng(1))
            points = [(tuple(eyes.uv_i[k]), tuple(eyes.uv_j[k])) for k in order]
            for n, (left, right) in enumerate(points[:-1]):
                who.pick_by_mouse(left, points[-1][1] if n == 1 else right)
                if who.joined() or "Point 2 does not fit" in who.bar():
                    break
            who.shot("named")
            named, mended = who.bar(), who.mend()
            for left, right in points[n + 1 : -1]:
                if who.joined():
                    break
                who.pick_by_mouse(left, right)
            who.until("joined fleet", who.joined, JOINED_S)
            who.shot("mended")
        return {"named": named, "mended_actions": mended, "wrong_joined": True}

    def _eyes(self, left: str, right: str) -> Eyes:
        seen = [self.observer.newest_view(name) for name in (left, right)]
        if seen[0] is None or seen[1] is None:
            raise FleetPoseError(f"no view of {left} or {right} was heard")
        return Eyes.of(self.plan.truth, seen[0], seen[1])

    def _take_back(self, page: Any) -> None:
        """Until the last robot is apart again."""
        while rows := page.locator("#pair .row").count():
            page.keyboard.press("u")
            end = time.monotonic() + SHOWN_S
            while page.locator("#pair .row").count() >= rows:
                page.wait_for_timeout(20)
                if time.monotonic() > end:
                    raise FleetPoseError(f"a point of {rows} cannot be taken back")

        def apart() -> bool:
            seen = self.observer.poses().get(self.plan.names[-1])
            return seen is None or not seen.pose.located

        if not wait_running(self.fleet, apart, JOINED_S):
            raise FleetPoseError(f"{self.plan.names[-1]} stays located without points")


def try_out(out: Path) -> dict[str, Any]:
    """Starts a demo's fleet and a page, and lets three newcomers try it; keeps pictures.

    Args:
        out: folder for logs and pictures.

    Returns:
        `clicks` and `keys` from the page's first sight to the joined fleet, each by one of them
        alone; `mended_actions` from the sentence that names a wrong click to where it is mended;
        `joined`.

    Raises:
        FleetPoseError: the page did not show what it should; the sentence says what.
    """
    from playwright.sync_api import sync_playwright

    folder = output_folder(out)
    tokens = {name: secrets.token_hex(16) for name in ("mouse", "keys", "wrong")}
    scratch = Path(tempfile.mkdtemp(prefix="fleetpose-tryout-"))
    token_file = scratch / "tokens"
    token_file.write_text("".join(f"{name}:{token}\n" for name, token in tokens.items()))
    token_file.chmod(0o600)
    with _state_home(scratch), LocalFleet(folder / "logs") as fleet:
        plan = demo_plan(ROBOTS, scratch)
        start_demo(fleet, plan, scratch)
        listen = f"127.0.0.1:{free_port()}"
        page = ("web", *fleet.connection, "--listen", listen, "--token-file", str(token_file))
        fleet.start("page", "fleetpose.hmi_client", *page, "--no-open")
        with observed(fleet) as observer, sync_playwright() as playwright:
            wait_started(fleet, observer, ROBOTS)
            arguments = ["--no-sandbox", "--disable-gpu"]
            path = shutil.which("chromium")
            chromium = playwright.chromium.launch(executable_path=path, args=arguments)
            trial = _Trial(fleet, plan, observer, f"http://{listen}/", tokens, chromium, folder)
            found = {"clicks": trial.by_mouse(), "keys": trial.by_keys(), "joined": True}
            found |= trial.with_a_wrong_click()
            chromium.close()
    return found


@contextmanager
def _state_home(folder: Path) -> Iterator[None]:
    """What clients keep is kept there."""
    before = os.environ.get("XDG_STATE_HOME")
    os.environ["XDG_STATE_HOME"] = str(folder)
    try:
        yield
    finally:
        if before is None:
            del os.environ["XDG_STATE_HOME"]
        else:
            os.environ["XDG_STATE_HOME"] = before
