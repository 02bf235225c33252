"""A page in each of its states, one after the other, each driven by a desk at a real bridge."""

from collections.abc import Callable, Iterator
from typing import Any

from fleetpose.evaluation.system.web import hands
from fleetpose.evaluation.system.web.bench import Bench
from fleetpose.evaluation.system.web.site import WebSite
from fleetpose.evaluation.system.web.states.fingers import READ_MS, PageFingers
from fleetpose.evaluation.system.web.states.pieces import PiecesSite

WRONG_PX = 70.0  # to the right of its place
_OUTLIER_S, _SILENT_S, _NO_IMAGE_S = 40.0, 15.0, 15.0
Scene = tuple[str, Any]


def scenes(bench: Bench) -> Iterator[Scene]:
    """The name of each state and the page in it, which goes on when the next one is asked for."""
    yield from _of_many(bench)
    bench.site.fleet.close()
    yield from _of_nothing_asked(bench)
    yield from _of_pieces(bench)


def _of_many(bench: Bench) -> Iterator[Scene]:
    """A fleet of 72 that is stood in for."""
    page = bench.browser.page(bench.site.address())
    hands.open_pair(page)
    page.keyboard.press("Space")
    hands.wait_knows(page, "state.list.half && state.matrix && state.poses")
    yield "72 robots", page
    for name, key, back in (
        ("overview", "o", "o"),
        ("images only", "m", "m"),
        ("keys", "?", "Escape"),
    ):
        page.keyboard.press(key)
        yield name, page
        page.keyboard.press(back)
    page.context.close()


def _of_nothing_asked(bench: Bench) -> Iterator[Scene]:
    with WebSite(8, out=bench.out / "idle", questions=0) as site:
        page = bench.browser.page(site.address())
        hands.wait_knows(page, "state.step?.tone === 'done' && state.poses && state.matrix")
        yield "nothing asked", page
        page.context.close()


def _of_pieces(bench: Bench) -> Iterator[Scene]:
    """A real fleet in two pieces."""
    with PiecesSite(bench.out / "pieces") as site:
        page = bench.browser.page(site.address())
        fingers = PageFingers(page, site)
        pair = fingers.answer(0, by_hand=True)
        for name, bring in (
            ("half", _to_half),
            ("suggestion", _to_suggestion),
            ("wrong click", _to_wrong_click),
            ("server gone", lambda page, fingers: _to_silence(page, site)),
            ("no image", lambda page, fingers: _to_no_image(page, site, pair)),
        ):
            bench.said(name)
            go_on = bring(page, fingers)
            yield name, page
            go_on()
        page.context.close()


def _to_half(page: Any, fingers: PageFingers) -> Callable[[], None]:
    fingers.half()
    fingers.picked.clear()
    return lambda: page.keyboard.press("c")


def _to_suggestion(page: Any, fingers: PageFingers) -> Callable[[], None]:
    hands.wait_knows(page, "!state.list.half && state.step.actions[0].do === 'accept'")
    page.evaluate("() => document.activeElement.blur()")
    page.wait_for_timeout(READ_MS)
    page.keyboard.press("Enter")
    hands.wait_knows(page, "state.assist.suggestion")
    return lambda: page.keyboard.press("c")


def _to_wrong_click(page: Any, fingers: PageFingers) -> Callable[[], None]:
    """Three points where they belong, and one where it does not."""
    hands.wait_knows(page, "!state.assist.suggestion")
    for off_px in (0.0, 0.0, 0.0, WRONG_PX):
        fingers.by_hand(off_px)
    hands.wait_knows(page, "state.assist.wrong", _OUTLIER_S)
    page.keyboard.press("d")
    hands.wait_knows(
        page, "state.list.points.some((p) => p.id === state.assist.wrong?.id && !p.other_view)"
    )
    return lambda: page.keyboard.press("x")


def _to_silence(page: Any, site: PiecesSite) -> Callable[[], None]:
    """Two clicks at a server that does not hear them."""
    hands.wait_knows(page, "state.health.unconfirmed === 0")
    site.silence_server(True)
    hands.pick_by_keys(page, 2)
    hands.wait_knows(page, "state.health.server === 'gone' && state.health.kept", _SILENT_S)
    return lambda: site.silence_server(False)


def _to_no_image(page: Any, site: PiecesSite, pair: tuple[str, str]) -> Callable[[], None]:
    """Another pair, one of whose robots is silent."""
    hands.wait_knows(page, "state.health.server === 'ok'", _SILENT_S)
    other = next(name for name in site.plan.names if name not in pair)
    site.fleet.signal(other, "SIGSTOP")
    page.evaluate(hands.RUN, ["select", {"a": pair[0], "b": other}])
    hands.wait_knows(page, f"state.list.pair?.includes('{other}')", _NO_IMAGE_S)
    page.wait_for_timeout(1000)
    return lambda: site.fleet.signal(other, "SIGCONT")
