"""The operator's page on the fleet of `pose-eval demo`, tried by newcomers: one by mouse alone, one
by keys alone, and one who clicks a wrong point.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from fleetpose.deploy.local_fleet import LocalFleet
from fleetpose.evaluation.options.fleets import FleetOptions, OperateOptions
from fleetpose.evaluation.options.names import CloudKind
from fleetpose.evaluation.report.output import output_folder
from fleetpose.evaluation.simulate.operator import far_apart
from fleetpose.evaluation.system.demo import demo_plan, start_demo
from fleetpose.evaluation.system.fleet import FleetPlan, observed, plan_fleet, wait_started
from fleetpose.evaluation.system.observer import Observer
from fleetpose.evaluation.system.web.browser import Browser
from fleetpose.evaluation.system.web.newcomer import PRIMARY, Eyes, Hand, Newcomer, Pixel
from fleetpose.protocol.errors import FleetPoseError
from fleetpose.protocol.transport import free_port

ROBOTS = 6
STARTED_S = 60.0
JOINED_S = 20.0
NOISE_PX = 1.0


@dataclass
class _Trial:
    """A fleet whose last robot waits for clicks, its page, and a browser."""

    fleet: LocalFleet
    plan: FleetPlan
    observer: Observer
    url: str
    browser: Browser
    out: Path

    @contextmanager
    def newcomer(self) -> Iterator[Newcomer]:
        """Somebody who has read what the page says once the machine is through."""
        page = self.browser.page(self.url)
        who = Newcomer(page, self._eyes, self.out)
        robots = len(self.plan.robots)
        alone = f"{robots - 1} of {robots} located"
        who.until("fleet but one", lambda: alone in page.inner_text("#summary"), STARTED_S)
        page.wait_for_timeout(3000)  # it is read
        yield who
        page.close()

    def by_mouse(self) -> int:
        """Clicks from the first sight of the page to the joined fleet."""
        with self.newcomer() as who:
            go = lambda: who.click(PRIMARY)  # noqa: E731
            no = lambda: who.click("#bar .button:nth-of-type(2)")  # noqa: E731
            who.answer(Hand(go, go, no, lambda: who.click("footer .hint:first-child")))
        return who.deeds

    def by_keys(self) -> int:
        """Keys for the same."""
        with self.newcomer() as who:
            keys = (lambda k=k: who.press(k) for k in ("Enter", "Tab", "Shift+Tab", "n"))
            who.answer(Hand(*keys))
        return who.deeds

    def with_a_wrong_click(self) -> dict[str, Any]:
        """The second point is clicked at another one, as if both were targets that look alike."""
        with self.newcomer() as who:
            who.click(PRIMARY)
            *points, other = _far_apart(who.look(), 8)
            points[1] = points[1][0], other[1]
            while points and "Point 2 does not fit" not in who.bar():
                who.pick_by_mouse(*points.pop(0))
            who.shot("named")
            named, mended = who.bar(), who.mend()
            self._pick_until_joined(who, points)
            who.shot("mended")
        return {"named": named, "mended_actions": mended}

    def by_hand(self) -> int:
        """Clicks until the fleet is joined without a suggestion, points up to `NOISE_PX` off."""
        with self.newcomer() as who:
            who.click(PRIMARY)
            rng = np.random.default_rng(0)
            off = rng.uniform(-NOISE_PX, NOISE_PX, (8, 2, 2))
            true = np.array(_far_apart(who.look(), 8)) + off
            self._pick_until_joined(who, [(tuple(i), tuple(j)) for i, j in true.tolist()])
            who.shot("joined")
        return who.deeds

    def _pick_until_joined(self, who: Newcomer, points: list[tuple[Pixel, Pixel]]) -> None:
        for left, right in points:
            if who.joined():
                return
            who.pick_by_mouse(left, right)
        who.until("joined fleet", who.joined, JOINED_S)

    def _eyes(self, left: str, right: str) -> Eyes:
        seen = [self.observer.newest_view(name) for name in (left, right)]
        if seen[0] is None or seen[1] is None:
            raise FleetPoseError(f"no view of {left} or {right} was heard")
        return Eyes.of(self.plan.truth, seen[0], seen[1])


def _far_apart(eyes: Eyes, count: int) -> list[tuple[Pixel, Pixel]]:
    """So many points that both images show."""
    order = far_apart(eyes.uv_i, count, np.random.default_rng(1))
    return [(tuple(eyes.uv_i[k].tolist()), tuple(eyes.uv_j[k].tolist())) for k in order]


def try_out(out: Path) -> dict[str, Any]:
    """Tries the page in a browser of its own; see `tried`."""
    with Browser() as browser:
        return tried(output_folder(out), browser)


def tried(out: Path, browser: Browser) -> dict[str, Any]:
    """Starts a fleet and a page for each of three newcomers, who try it; keeps pictures.

    Args:
        out: folder for logs and pictures.
        browser: runs.

    Returns:
        `clicks` and `keys` from the page's first sight to the joined fleet; `named`, the sentence
        that names a wrong click, and `mended_actions` from there to where it is mended; `joined`.

    Raises:
        FleetPoseError: the page did not show what it should; the sentence says what.
    """
    with _trial(out / "mouse", browser) as trial:
        found: dict[str, Any] = {"clicks": trial.by_mouse()}
    with _trial(out / "keys", browser) as trial:
        found["keys"] = trial.by_keys()
    with _trial(out / "wrong", browser) as trial:
        found |= trial.with_a_wrong_click()
    return found | {"joined": True}


def clicks_by_hand(out: Path, browser: Browser, data: Path, clouds: CloudKind | None = None) -> int:
    """Clicks until three robots on a recording are joined, without suggestions."""
    options = OperateOptions(data=data, clouds=clouds).of_fleet()
    with _trial(out / "by-hand", browser, options) as trial:
        return trial.by_hand()


@contextmanager
def _trial(
    out: Path, browser: Browser, fleet_options: FleetOptions | None = None
) -> Iterator[_Trial]:
    """A fleet, of a demo or on a recording, and its page; both end."""
    out.mkdir(parents=True, exist_ok=True)
    for old in out.glob("*.png"):
        old.unlink()
    with ExitStack() as closing:
        scratch = Path(closing.enter_context(TemporaryDirectory(prefix="fleetpose-tryout-")))
        closing.enter_context(_state_home(scratch))
        fleet = closing.enter_context(LocalFleet(out / "logs"))
        asked = fleet_options
        plan = demo_plan(ROBOTS, scratch) if asked is None else plan_fleet(asked, scratch)
        start_demo(fleet, plan, scratch)
        url = f"http://127.0.0.1:{free_port()}/"
        page = ("web", *fleet.connection, "--listen", url[7:-1], "--no-open")
        fleet.start("page", "fleetpose.hmi_client", *page)
        observer = closing.enter_context(observed(fleet))
        wait_started(fleet, observer, len(plan.robots))
        token = (scratch / "fleetpose" / "web-token").read_text().strip()
        yield _Trial(fleet, plan, observer, f"{url}#token={token}", browser, out)


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
